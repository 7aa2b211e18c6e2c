"""What can be asked of a model without torch besides the sentence."""

from __future__ import annotations

from dataclasses import dataclass

from robots.errors import SpecError

MANNER = ("tempo", "energy", "amplitude")
"""Settings of the manner; the tempo is the ``speed`` of the choreographer's style."""
MOST_PEOPLE = 8
"""People in one scene."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffusionRequest:
    """What to generate besides the sentence; what is ``None`` is the model's own choice.

    Raises:
        SpecError: A number is out of range, or settings exclude each other.
    """

    weights: str = ""
    """Folder of a model; the one that ships by default."""
    frames: int | None = None
    """Length of each part in frames of the model."""
    seconds: float | None = None
    """Length of each part in seconds, instead of ``frames``."""
    steps: int | None = None
    """Sampling steps."""
    guidance: float | None = None
    """Weight of the sentence."""
    threads: int | None = None
    """Threads; one by default."""
    then: tuple[str, ...] = ()
    """Sentences of further parts."""
    tempo: float = 1.0
    """How fast it is played, compared with how it was drawn."""
    energy: float = 1.0
    """Vigour; 1 is what the sentence says."""
    amplitude: float = 1.0
    """Size of movements; 1 is what the sentence says."""
    like: tuple[str, ...] = ()
    """Takes to vary: motion files, or seeds of the same request."""
    unlike: tuple[str, ...] = ()
    """Takes to keep away from."""
    people: int = 2
    """How many take part."""
    nearest: bool = False
    """Draw the nearest interaction for a sentence outside the repertoire of the model."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.frames is not None and self.seconds is not None:
            raise SpecError("frames and seconds", allowed="one of them")
        if self.frames is not None and not self.frames >= 2:
            raise SpecError(f"{self.frames} frames", where="--frames", allowed="2 or more")
        if self.seconds is not None and not 0.3 <= self.seconds <= 3600:
            raise SpecError(f"{self.seconds} s", where="--seconds", allowed="0.3 to 3600")
        if self.threads is not None and self.threads < 1:
            raise SpecError(f"{self.threads}", where="--threads", allowed="1 or more")
        if not 2 <= self.people <= MOST_PEOPLE:
            raise SpecError(f"{self.people}", where="--people", allowed=f"2 to {MOST_PEOPLE}")
        self._require_manner()
        self._require_one_part()

    def _require_manner(self) -> None:
        asked = {name: getattr(self, name) for name in MANNER if getattr(self, name) != 1}
        if asked:
            from generator.choreographer.style import style_ranges

            ranges = style_ranges()
            for name, value in asked.items():
                low, high = ranges["speed" if name == "tempo" else name]
                if not low <= value <= high:
                    raise SpecError(f"{value}", where=f"--{name}", allowed=f"{low} to {high}")

    def _require_one_part(self) -> None:
        """Check that what is of one part is not asked of several."""
        if not self.then and self.people == 2:
            return
        for name in ("like", "unlike"):
            if getattr(self, name):
                other = "--then" if self.then else "--people"
                raise SpecError(f"--{name} with {other}", allowed="one of them")
