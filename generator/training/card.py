"""The model card: what somebody who finds a folder of weights has to know."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from generator.model import InterGen
from generator.runtime.portable import Precision, Sampling

CARD = "MODEL_CARD.md"

_TEXT = """\
# {name}

Text to the motion of two people by diffusion, after InterGen (Liang et al., IJCV 2024); own code
and own weights. Draw from it with `pasdedeux generate "..." --generator diffusion --weights
FOLDER`, or with torch by `--generator intergen`.

| | |
|---|---|
| licence of the weights and of what is drawn from them | {licence} |
| numbers | {count:.2f} million, {sizes} |
| sentences | {text}, frozen |
| motion | {fps:g} frames per second, up to {seconds:.1f} s |
| network without torch | {precision} |
| drawn by default with | {sampling} |
| data | {data} |
| trained for | {steps} steps |
| losses at the end, weighted | {losses} |

## Limits

It knows what its data show and nothing else: sentences about other things give a motion, but not
of them. Longer motions than it has learnt are refused. Bones are as long as their keypoints lie
apart, which varies over a motion; feet may slide. No figure of quality is stated here: `pasdedeux
evaluate` measures them, and compares only what the same evaluator has judged.
"""


def model_card(model: InterGen, sampling: Sampling, precision: Precision) -> str:
    """Return the card of a model, from what it knows of itself."""
    facts, config = model.provenance.training, model.config
    losses = facts.get("losses") or {}
    chosen = asdict(sampling)
    frames = chosen.pop("frames")
    return _TEXT.format(
        name=model.provenance.source or "A model",
        licence=model.provenance.licence or "unknown",
        count=sum(p.numel() for p in model.denoiser.parameters()) / 1e6,
        sizes=f"{config.layers} layers of {config.width}, {config.heads} heads",
        text=facts.get("text", "unknown"),
        fps=model.provenance.fps,
        seconds=frames / model.provenance.fps,
        precision=precision,
        sampling=_listed(chosen),
        data=", ".join(map(str, facts.get("data", []))) or "unknown",
        steps=facts.get("steps", "unknown"),
        losses=_listed({k: f"{v:.4f}" for k, v in losses.items() if k != "norm"}) or "unknown",
    )


def _listed(values: dict[str, Any]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in values.items())
