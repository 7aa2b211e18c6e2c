"""From sentences to a duet with a model that needs no torch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from generator.diffusion import SamplerConfig
from generator.features import decode
from generator.model_folder import shipped_folder
from generator.motion import MAX_FRAMES, DuetMotion
from generator.runtime.accents import accents_of, sentence
from generator.runtime.drawing import PLAIN, Progress, Steering, draw
from generator.runtime.network import Floats, halves
from generator.runtime.portable import Portable
from generator.runtime.repertoire import NOTHING_READ, Reading, read
from generator.runtime.request import MANNER, DiffusionRequest
from generator.runtime.sequence import Window, held_beginning, overlap_of, plan, sequence
from generator.text.encoder import SentenceEncoder, packaged_encoder
from robots.errors import CheckpointError, PromptError, SpecError
from robots.skeleton import FloatArray

SECONDS = 6.5
"""Length of a part if nothing else decides it: half of the choreographer's duets are shorter."""
FINISHED_FPS = 30.0
"""Frames per second that a motion has in the end; a motion file holds so many frames."""
THEN = ", then "
"""What joins the sentences of a sequence."""


@dataclass(frozen=True, slots=True, eq=False)
class Studio:
    """A model with what a request chooses of it, ready to draw."""

    model: Portable
    """The model."""
    encoder: SentenceEncoder
    """That of the model."""
    sampler: SamplerConfig
    """How motions are drawn."""
    request: DiffusionRequest
    """Everything that is asked for besides sentences."""
    reading: Reading = NOTHING_READ
    """What the sentences mean, if the model knows the repertoire alone."""

    def cond(self, text: str) -> Floats:
        """Return the vector ``[1, C]`` of a sentence, or of what it says of person a."""
        return self._vector(self._drawn(text)[0])

    def steering(self, text: str) -> Steering:
        """Return what acts on the draw: energy, amplitude, and what only person b does."""
        drawn = self._drawn(text)
        accents = [accents_of(said, self.request, self.encoder) for said in drawn]
        if len(drawn) == 1:
            return Steering(accents=accents[0]) if accents[0] else PLAIN
        masks = halves(2 * self.model.config.features)
        own = [
            accent._replace(weight=accent.weight * mask)
            for mask, of_person in zip(masks, accents, strict=True)
            for accent in of_person
        ]
        return Steering(accents=tuple(own), other=self._vector(drawn[1]))

    @property
    def fps(self) -> float:
        """Frames per second at which the motion is played."""
        return self.model.provenance.fps * self.request.tempo

    def _vector(self, said: str) -> Floats:
        return np.asarray(self.encoder.encode([sentence(said)]), np.float32)

    def _drawn(self, text: str) -> tuple[str, ...]:
        """Return what is drawn for a sentence: one for both people, or one for each."""
        return self.reading.apart.get(text) or (self.reading.instead.get(text, text),)


def generate(
    text: str,
    request: DiffusionRequest,
    *,
    seed: int = 0,
    encoder: SentenceEncoder | None = None,
    progress: Progress | None = None,
) -> tuple[DuetMotion, dict[str, Any]]:
    """Return a duet and the facts of how it was made.

    Args:
        text: The sentence; ``request.then`` has those of further parts.
        request: Everything else.
        seed: The same seed gives the same duet on the same machine.
        encoder: Sentence encoder; the one that ships by default.
        progress: Called with the share done, 0 to 1.

    Raises:
        PromptError: A sentence is empty or outside the repertoire of the model.
        CheckpointError: The model is missing or damaged.
        MotionFileError: A take cannot be read.
        SpecError: A setting is out of range.
    """
    texts = (text, *request.then)
    studio = open_studio(texts, request, seed, encoder)
    facts = facts_of(studio)
    parts = part_frames(studio, len(texts))
    overlap = overlap_of(studio.model.sampling.frames, studio.model.provenance.fps)
    windows = plan(parts, studio.model.sampling.frames, overlap)
    if len(windows) == 1:
        features = _one(studio, text, parts[0], seed, progress)
    else:
        features = _many(studio, texts, windows, overlap, seed, progress)
        ends = np.cumsum(parts) / studio.fps
        facts["parts"] = [
            {"text": part, "end": round(float(end), 3)}
            for part, end in zip(texts, ends, strict=True)
        ]
        facts["windows"] = len(windows)
    return as_motion(studio, features, THEN.join(_spoken(texts)), seed), facts


def open_studio(
    texts: tuple[str, ...],
    request: DiffusionRequest,
    seed: int = 0,
    encoder: SentenceEncoder | None = None,
) -> Studio:
    """Return a model with its encoder and sampler, after a look at what is to be drawn.

    Raises:
        SpecError: The seed is negative.
        PromptError: A sentence is empty, or the model knows the repertoire alone and the sentence
            is outside.
        CheckpointError: The model is missing or damaged.
    """
    if not all(text.strip() for text in texts):
        raise PromptError("the sentence is empty")
    if seed < 0:
        raise SpecError(f"{seed}", where="--seed", allowed="0 or more")
    model = Portable.load(chosen_folder(request.weights), threads=request.threads or 1)
    if encoder is None:
        encoder = packaged_encoder(model.text_encoder)
        if encoder is None:
            raise CheckpointError(
                f"the model was made with the text encoder '{model.text_encoder}', which does not"
                " come with it",
                where=request.weights,
            )
    return Studio(
        model,
        encoder,
        model.sampling.sampler(request.steps, request.guidance),
        request,
        read(texts, nearest=request.nearest) if model.repertoire else NOTHING_READ,
    )


def facts_of(studio: Studio) -> dict[str, Any]:
    """Return what is known before anything is drawn, as JSON."""
    request = studio.request
    facts: dict[str, Any] = {
        "weights": request.weights or "shipped",
        "model": studio.model.provenance.source,
        "steps": studio.sampler.steps,
        "guidance": studio.sampler.guidance,
    }
    facts |= {name: getattr(request, name) for name in MANNER if getattr(request, name) != 1}
    facts |= {k: list(v) for k in ("like", "unlike") if (v := getattr(request, k))}
    if studio.reading.facts:
        facts["understood"] = list(studio.reading.facts)
    if studio.reading.instead:
        facts["drawn_as"] = dict(studio.reading.instead)
    if studio.reading.apart:
        facts["drawn_apart"] = {text: list(said) for text, said in studio.reading.apart.items()}
    return facts


def as_motion(studio: Studio, features: FloatArray, text: str, seed: int) -> DuetMotion:
    """Return the motion of features ``[T, 2, 262]``, played at the tempo that is asked for.

    Rotations are those that were drawn: keypoints alone do not tell how head and limbs are turned.
    """
    provenance = studio.model.provenance
    return decode(
        features,
        studio.fps,
        rotations="features",
        text=text,
        seed=seed,
        source=provenance.source,
        licence=provenance.licence,
    )


def part_frames(studio: Studio, count: int) -> list[int]:
    """Return how many frames each of so many parts has; without a wish, as many as fit a window.

    Raises:
        SpecError: There are more than a motion may have, or the model cannot go on from its own
            frames.
    """
    request, model = studio.request, studio.model
    fps, longest = model.provenance.fps, model.sampling.frames
    overlap = overlap_of(longest, fps)
    if request.frames is not None:
        parts = [request.frames] * count
    elif request.seconds is not None:
        parts = [max(2, round(request.seconds * studio.fps))] * count
    else:
        usual = round(SECONDS * fps)
        parts = [min(usual, longest), *[min(usual, longest - overlap)] * (count - 1)]
        if count == 1 and (taken := _take_frames(studio)):
            parts = [min(taken, longest)]
    played = round(sum(parts) * max(1.0, FINISHED_FPS / studio.fps))
    if played > MAX_FRAMES:
        raise SpecError(f"{played} frames", where="length", allowed=f"up to {MAX_FRAMES}")
    several, takes = len(plan(parts, longest, overlap)) > 1, request.like or request.unlike
    if (several or takes) and model.config.representation == "canonical":
        raise SpecError(
            f"{sum(parts)} frames, or takes, from a model whose representation holds no places",
            where="length",
            allowed=f"2 to {longest} frames without takes",
        )
    if several and parts[0] <= overlap:
        raise SpecError(
            f"parts of {parts[0] / studio.fps:.2g} s",
            where="length",
            allowed=f"more than the {overlap / studio.fps:.2g} s that two of them share",
        )
    if several and takes:
        raise SpecError(f"--like and --unlike with {sum(parts)} frames", allowed=f"2 to {longest}")
    return parts


def chosen_folder(weights: str) -> Path:
    """Return the folder of the model that is asked for; of the one that ships by default.

    Raises:
        CheckpointError: None ships with this version.
    """
    if weights:
        return Path(weights)
    shipped = shipped_folder()
    if shipped is None:
        raise CheckpointError(
            "no model ships with this version",
            hint="name one with --weights (pasdedeux train makes them), or take --generator"
            " choreographer",
        )
    return shipped


def _one(
    studio: Studio, text: str, frames: int, seed: int, progress: Progress | None
) -> FloatArray:
    """Return the features of one window, varied from or kept away from takes."""
    from generator.runtime.takes import read_take

    request, cond, steering = studio.request, studio.cond(text), studio.steering(text)

    def redraw(other: int) -> FloatArray:
        return draw(
            studio.model, cond, frames, studio.sampler, seed=other, steering=steering
        )[0]  # fmt: skip

    def take(name: str) -> Floats:
        return read_take(name, studio.model, frames, redraw)

    if request.like:
        # Of several takes each seed varies one: their mean would be nobody's motion.
        start = take(request.like[seed % len(request.like)])
        steering = replace(steering, start=start)
    if request.unlike:
        steering = replace(steering, avoid=tuple(take(name) for name in request.unlike))
    return draw(
        studio.model, cond, frames, studio.sampler, seed=seed, steering=steering, progress=progress
    )[0]


def _many(
    studio: Studio,
    texts: tuple[str, ...],
    windows: list[Window],
    overlap: int,
    seed: int,
    progress: Progress | None,
) -> FloatArray:
    """Return the features of a sequence of windows."""

    def draw_window(number: int, window: Window, beginning: FloatArray | None) -> FloatArray:
        text = texts[window.part]
        steering = studio.steering(text)
        if beginning is not None:
            held = held_beginning(studio.model, beginning, window.frames)
            steering = replace(steering, held=held)

        def told(share: float) -> None:
            if progress is not None:
                progress((number + share) / len(windows))

        return draw(
            studio.model,
            studio.cond(text),
            window.frames,
            studio.sampler,
            # The first window is the motion that the sentence has alone.
            seed=(seed, number) if number else seed,
            steering=steering,
            progress=told,
        )[0]

    return np.concatenate(list(sequence(windows, overlap, draw_window)))


def _take_frames(studio: Studio) -> int | None:
    """Return the length of the first liked take that is a file, in frames of the model."""
    from generator.runtime.takes import take_frames

    fps = studio.model.provenance.fps
    for name in studio.request.like:
        if frames := take_frames(name, fps):
            return frames
    return None


def _spoken(texts: tuple[str, ...]) -> list[str]:
    """Return sentences as parts of one; a single one stays as it is."""
    if len(texts) == 1:
        return list(texts)
    return [text.strip().rstrip(".") for text in texts]
