"""How fast InterGen draws a motion on this CPU, against the public release's way of computing it.

    python benchmarks/generate.py [--threads N] [--frames 300] [--width 1024]

The baseline is the same mathematics with the same weights, computed as the release does it:
``nn.MultiheadAttention``, float32, torch's defaults, both persons one after the other, time and
text embedded anew in every step. One guided step of it is timed and multiplied by its 50 steps; all
else is timed as it runs. Weights are random: what fewer digits and fewer steps cost in quality has
to be measured on a trained model, not here.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from generator.architecture import DenoiserConfig
from generator.denoiser import Denoiser
from generator.model import InterGen
from generator.precision import PRECISIONS, medium_is_float32, prepared
from generator.threads import default_threads, thread_limit

FEW = 10
"""Steps of the few-step setting: DPM-Solver++(2M), trailing."""


class BaselineNorm(nn.Module):
    """Layer norm with scale and shift from a linear of its own."""

    def __init__(self, width: int) -> None:
        """Make or take the layers."""
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False, eps=1e-6)
        self.linear = nn.Linear(width, 2 * width)

    def forward(self, hidden: Tensor, embedding: Tensor) -> Tensor:
        """Return the next states."""
        scale, shift = self.linear(functional.silu(embedding))[:, None].chunk(2, dim=-1)
        return self.norm(hidden) * (1 + scale) + shift


class BaselineBlock(nn.Module):
    """One block for one person, with the library's attention."""

    def __init__(self, config: DenoiserConfig) -> None:
        """Make or take the layers."""
        super().__init__()
        width, heads = config.width, config.heads
        self.norms = nn.ModuleList(BaselineNorm(width) for _ in range(4))
        self.own = nn.MultiheadAttention(width, heads, batch_first=True, add_zero_attn=True)
        self.mutual = nn.MultiheadAttention(width, heads, batch_first=True, add_zero_attn=True)
        self.inner = nn.Linear(width, config.feedforward)
        self.outer = nn.Linear(config.feedforward, width)

    def forward(self, hidden: Tensor, partner: Tensor, embedding: Tensor) -> Tensor:
        """Return the next states."""
        own = self.norms[0](hidden, embedding)
        hidden = hidden + self.own(own, own, own, need_weights=False)[0]
        queries = self.norms[2](hidden, embedding)
        context = self.norms[3](partner, embedding)
        hidden = hidden + self.mutual(queries, context, context, need_weights=False)[0]
        inner = functional.gelu(self.inner(self.norms[1](hidden, embedding)))
        return hidden + self.outer(inner)


class Baseline(nn.Module):
    """The denoiser, computed person by person, with a denoiser's weights."""

    def __init__(self, denoiser: Denoiser) -> None:
        """Make or take the layers."""
        super().__init__()
        self.denoiser = denoiser
        net = denoiser.networks[0]
        self.blocks = nn.ModuleList()
        for block in net.blocks:
            copy = BaselineBlock(denoiser.config)
            pairs = [(copy.inner, block.feedforward.inner), (copy.outer, block.feedforward.outer)]
            weights = block.modulation.weight.chunk(4), block.modulation.bias.chunk(4)
            for norm, weight, bias in zip(copy.norms, *weights, strict=True):
                norm.linear.weight.data, norm.linear.bias.data = weight, bias  # type: ignore[union-attr]
            own, mutual = block.self_attention, block.mutual_attention
            for kind in ("weight", "bias"):
                packed = getattr(own.project, kind)
                getattr(copy.own, f"in_proj_{kind}").data = packed.data
                parts = [getattr(mutual.query, kind), getattr(mutual.key_value, kind)]
                getattr(copy.mutual, f"in_proj_{kind}").data = torch.cat(parts).data
            pairs += [(copy.own.out_proj, own.out), (copy.mutual.out_proj, mutual.out)]
            for target, source in pairs:
                target.weight.data, target.bias.data = source.weight.data, source.bias.data
            self.blocks.append(copy)

    def forward(self, x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        """Return the next states."""
        net = self.denoiser.networks[0]
        embedding = net.embed_time(self.denoiser.positions[t]) + net.embed_text(cond)
        a, b = (
            net.embed_motion(part) + self.denoiser.positions[: x.shape[1]]
            for part in x.chunk(2, dim=-1)
        )
        for block in self.blocks:
            a, b = block(a, b, embedding), block(b, a, embedding)
        return torch.cat([net.out(a), net.out(b)], dim=-1)


def make_model(config: DenoiserConfig) -> InterGen:
    """Return a model with random weights in every layer, without keeping two copies."""
    with torch.device("meta"):
        model = InterGen(config)
    model.to_empty(device="cpu")
    generator = torch.Generator().manual_seed(0)
    for value in model.parameters():
        scale = value.shape[-1] ** -0.5 if value.dim() > 1 else 0.05
        nn.init.normal_(value, std=scale, generator=generator)
    fresh = InterGen(DenoiserConfig(width=config.width, layers=1, heads=1, feedforward=1))
    model.denoiser.positions.copy_(fresh.denoiser.positions)
    model.set_statistics(torch.zeros(config.features), torch.ones(config.features))
    return model.eval()


@torch.no_grad()
def compare(model: InterGen, frames: int, rounds: int) -> None:
    """Print time and error per guided step of every precision, and of a whole clip.

    The contenders take turns, and the shortest run of each counts, so that what else the machine
    does meanwhile falls on all of them.
    """
    cond = torch.randn(1, model.config.text_width, generator=torch.manual_seed(1))
    x = torch.randn(1, frames, 2 * model.config.features, generator=torch.manual_seed(2))
    both, t = torch.cat([cond, torch.zeros_like(cond)]), torch.tensor([0, 0])
    baseline = Baseline(model.denoiser).eval()

    def released() -> Tensor:
        with_text, without = baseline(x.repeat(2, 1, 1), t, both).chunk(2)
        return without + 3.5 * (with_text - without)

    steps: dict[str, Callable[..., Tensor]] = {"released": released}
    for name in PRECISIONS:
        steps[name] = partial(prepared(model, name).sample, cond, frames, x_T=x, steps=1)
    outputs = {name: step() for name, step in steps.items()}
    times = dict.fromkeys(steps, float("inf"))
    for _ in range(rounds):
        for name, step in steps.items():
            times[name] = min(times[name], timed(step))
    exact, base = outputs["released"], times["released"]
    largest = float(exact.abs().max())
    print(f"one guided step, {frames} frames, {model.config.width} wide, numbers to {largest:.0f}")
    for name, output in outputs.items():
        error = float((output - exact).abs().max())
        print(
            f"  {name:10s} {times[name]:7.3f} s   x{base / times[name]:5.2f}"
            f"   error {error:.1e}, {error / largest:.1e} of the largest number"
        )
    clip = partial(steps["bfloat16"], steps=FEW, solver="dpm2m", spacing="trailing")
    whole = timed(clip)
    print(
        f"a whole clip, bfloat16, {FEW} steps: {whole:.2f} s, x{50 * base / whole:.1f}"
        f" of 50 steps the release's way ({50 * base:.0f} s)"
    )


def timed(function: Callable[[], object]) -> float:
    """Return the seconds that one call takes."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


@torch.no_grad()
def contended(model: InterGen, frames: int) -> None:
    """Print how much a second busy program slows sampling down."""
    cond = torch.randn(1, model.config.text_width, generator=torch.manual_seed(1))
    fast = prepared(model, "bfloat16")

    def run() -> Tensor:
        return fast.sample(cond, frames, steps=3, seed=0)

    run()
    alone = min(timed(run) for _ in range(3))
    busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        together = min(timed(run) for _ in range(3))
    finally:
        busy.kill()
        busy.wait()
    print(f"beside a busy program: {together / alone:.2f} of the time alone")


def peak(config: DenoiserConfig, frames: int, precision: str) -> None:
    """Print the most memory that this process held after one clip (run in a process of its own)."""
    model = make_model(config)
    model = prepared(model, precision)  # type: ignore[arg-type]
    model.sample(torch.randn(1, config.text_width), frames, steps=2, seed=0)
    # not getrusage: a child starts with its parent's figure
    status = Path("/proc/self/status").read_text()
    print(f"{int(status.partition('VmHWM:')[2].split()[0]) / 2**20:.2f}")


def main() -> None:
    """Run everything."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--threads", type=int, default=default_threads())
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--width", type=int, default=1024)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--peak", choices=PRECISIONS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    config = DenoiserConfig(width=options.width, feedforward=2 * options.width)
    with thread_limit(options.threads):
        if options.peak:
            peak(config, options.frames, options.peak)
            return
        print(f"torch {torch.__version__}, {options.threads} thread(s),", end=" ")
        print("'medium' is float32" if medium_is_float32() else "'medium' is bfloat16 (AMX)")
        model = make_model(config)
        compare(model, options.frames, options.rounds)
        contended(model, options.frames)
        del model
    if not Path("/proc/self/status").is_file():
        return
    for precision in PRECISIONS:
        command = [sys.executable, __file__, "--peak", precision, "--threads", str(options.threads)]
        command += ["--frames", str(options.frames), "--width", str(options.width)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        print(f"peak memory, {precision}: {done.stdout.strip()} GiB")


if __name__ == "__main__":
    main()
