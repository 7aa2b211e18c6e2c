"""Real and generated motions of an evaluation, and their embeddings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from generator.canonical import from_canonical
from generator.data import BatchStream
from generator.diffusion import SamplerConfig
from generator.evaluator import InterClip
from generator.features import POSITIONS
from generator.model import InterGen
from generator.scores import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Clips as one repetition draws them."""

    names: tuple[str, ...]
    """Of the clips."""
    texts: tuple[str, ...]
    """One sentence each."""
    lengths: NDArray[np.int64]
    """``[N]`` frames."""
    text: Floats
    """``[N, E]`` embeddings of the sentences."""
    motion: Floats
    """``[N, E]`` embeddings of the real motions."""


@torch.no_grad()
def draw_real(evaluator: InterClip, stream: BatchStream, repetition: int) -> Drawn:
    """Return all clips once, as a repetition draws them, embedded."""
    first = repetition * stream.epoch
    samples = [stream.sample(first + i) for i in range(stream.epoch)]
    texts = tuple(text for _, text, _ in samples)
    lengths = np.array([len(features) for features, _, _ in samples])
    motion = embed(evaluator, [features for features, _, _ in samples], stream.config.size)
    text = evaluator.embed_text(evaluator.prepare(texts)).numpy()
    return Drawn(tuple(name for _, _, name in samples), texts, lengths, text, motion)


@torch.no_grad()
def embed(evaluator: InterClip, features: Sequence[NDArray], batch: int) -> Floats:
    """Return embeddings ``[N, E]`` of motions ``[T, 524]`` in metres, of any lengths."""
    lengths = np.array([len(x) for x in features])
    order = np.argsort(lengths, kind="stable")
    out = np.empty((len(features), evaluator.config.embedding), np.float32)
    for start in range(0, len(order), batch):
        rows = order[start : start + batch]
        padded = np.zeros((len(rows), lengths[rows].max(), features[0].shape[1]), np.float32)
        for slot, row in zip(padded, rows, strict=True):
            slot[: lengths[row]] = features[row]
        embedded = evaluator.embed_motion(torch.from_numpy(padded), torch.from_numpy(lengths[rows]))
        out[rows] = embedded.numpy()
    return out


@torch.no_grad()
def generate(
    model: InterGen,
    texts: Sequence[str],
    lengths: NDArray[np.int64],
    seeds: Sequence[Sequence[int]],
    sampler: SamplerConfig,
    *,
    batch: int,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Floats]:
    """Return motions ``[T, 524]`` in metres, one per sentence, each from a seed of its own.

    Motions of one length are made together; which they are made with does not matter (but for the
    last bits).

    Args:
        model: With statistics and a text encoder.
        texts: N sentences.
        lengths: ``[N]`` frames.
        seeds: N seeds, each of one or several numbers.
        sampler: How.
        batch: Most motions at a time.
        progress: Called with the share done.
    """
    vectors: dict[str, Tensor] = {}
    out: dict[int, Floats] = {}
    for rows in batches_of_equal_length(lengths, batch):
        for i in rows:
            if texts[i] not in vectors:
                vectors[texts[i]] = model.encode_text([texts[i]])[0]
        cond = torch.stack([vectors[texts[i]] for i in rows])
        frames = int(lengths[rows[0]])
        noise = np.stack([noise_of(seeds[i], frames, 2 * model.config.features) for i in rows])
        drawn = model.sample(
            cond,
            frames,
            steps=sampler.steps,
            guidance=sampler.guidance,
            eta=sampler.eta,
            solver=sampler.solver,
            spacing=sampler.spacing,
            guidance_interval=sampler.guidance_interval,
            x_T=torch.from_numpy(noise).to(cond.device),
            seed=int(np.random.default_rng(seeds[rows[0]]).integers(2**31)),
        )
        metres = model.denormalise(drawn).unflatten(-1, (2, -1)).cpu().numpy()
        for i, features in zip(rows, metres, strict=True):
            if model.config.representation == "canonical":
                features = from_canonical(features)
            out[i] = features.reshape(frames, -1).astype(np.float32)
        progress(len(out) / len(texts))
    return [out[i] for i in range(len(texts))]


def noise_of(seed: Sequence[int], frames: int, width: int) -> Floats:
    """Return what a motion ``[frames, width]`` is drawn from; a seed is one or several numbers."""
    return np.random.default_rng(list(seed)).standard_normal((frames, width), np.float32)


def batches_of_equal_length(lengths: NDArray[np.int64], size: int) -> Iterable[list[int]]:
    """Yield the numbers of motions that can be drawn together, at most so many at a time."""
    for length in np.unique(lengths):
        rows = np.flatnonzero(lengths == length)
        for start in range(0, len(rows), size):
            yield rows[start : start + size].tolist()


def keypoints(features: Floats) -> Floats:
    """Return ``[T, 2, 22, 3]`` m, y-up, of features ``[T, 524]``."""
    return features.reshape(len(features), 2, -1)[..., POSITIONS].reshape(-1, 2, 22, 3)
