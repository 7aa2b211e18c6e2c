"""Two symmetries of a two-person motion: a mirror, and the exchange of the two people.

The paper (Sec. 5) mirrors every motion, with the sides in its sentence, and exchanges the people.
A sentence that does not say who is who holds for both orders; one that does ("the first person
pushes the second") is turned round together with the motion.

**The problem with words.** *left* and *right* are also verbs, idioms and parts of other words. The
public release replaces substrings, and so makes "rightover copyleft" of "leftover copyright" and
"countercounterclockwise" of "counterclockwise". Here whole words are replaced, and not in fixed
phrases such as "right away"; ``release_compat=True`` reproduces the release.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from generator.features import Poses
from generator.motion import Contact, DuetMotion, Motion
from robots.skeleton import Skeleton, human_skeleton


def _other_side(name: str) -> str:
    for side, other in (("left_", "right_"), ("right_", "left_")):
        if name.startswith(side):
            return other + name.removeprefix(side)
    return name


_SWAPPED = [human_skeleton().index(_other_side(name)) for name in human_skeleton()]
_SWAPPED_ROTATIONS = [j - 1 for j in _SWAPPED[1:]]
_SWAPPED_CONTACTS = [2, 3, 0, 1]
_MIRRORED_X = (-1.0, 1.0, 1.0)
_MIRRORED_SIXD = (1.0, -1.0, -1.0, 1.0, -1.0, 1.0)
"""M R M with M = diag(-1, 1, 1) changes the sign of r01, r10 and r20 among the six."""


def mirror_poses(poses: Poses) -> Poses:
    """Return the motion as seen in a mirror at the plane x = 0 of the y-up world."""
    contacts = poses.contacts
    return Poses(
        poses.positions[:, _SWAPPED] * _MIRRORED_X,
        poses.rotations[:, _SWAPPED_ROTATIONS] * _MIRRORED_SIXD,
        None if contacts is None else contacts[:, _SWAPPED_CONTACTS],
    )


def mirror_motion(motion: DuetMotion) -> DuetMotion:
    """Return the duet as seen in a mirror at the world's plane y = 0, sentence and labels too."""
    return replace(
        motion,
        a=_mirrored(motion.a),
        b=_mirrored(motion.b),
        text=mirror_text(motion.text),
        contacts=tuple(replace(c, a=_other_side(c.a), b=_other_side(c.b)) for c in motion.contacts),
    )


def _mirrored(motion: Motion) -> Motion:
    rotations, contacts = motion.rotations, motion.foot_contacts
    return Motion(
        motion.fps,
        motion.keypoints[:, _SWAPPED] * (1.0, -1.0, 1.0),
        None if rotations is None else rotations[:, _SWAPPED] * (1.0, -1.0, 1.0, -1.0),
        None if contacts is None else np.asarray(contacts)[:, _SWAPPED_CONTACTS],
        Skeleton(
            motion.skeleton.names,
            motion.skeleton.parents,
            motion.skeleton.offsets[_SWAPPED] * (1.0, -1.0, 1.0),
            motion.skeleton.hand_per_forearm,
        ),
    )


def swap_motion(motion: DuetMotion) -> DuetMotion:
    """Return the duet with its people exchanged, in the sentence and the labels too."""
    return replace(
        motion,
        a=motion.b,
        b=motion.a,
        text=swap_text(motion.text),
        contacts=tuple(Contact(c.b, c.a, c.start, c.end, c.gap) for c in motion.contacts),
    )


_IDIOMS = (
    r"right(?=\s+(?:away|now|there|here|after|before|behind|beside|next\s+to|in\s+front"
    r"|in\s+the\s+middle|up\s+to|angles?\b))"
    r"|(?<=\ball\s)right|(?<=that's\s)right"
    r"|left(?=\s+(?:alone|over|standing|lying|the\s+(?:room|stage|scene|place)))"
    r"|(?:(?<=\bhas\s)|(?<=\bhad\s)|(?<=\bhave\s))left(?=\s+(?:the|his|her|their|its|a|an)\b)"
    r"|(?:(?<=\bis\s)|(?<=\bare\s))left(?=\s+(?:with|behind|there|out)\b)"
)
"""Where the words are no sides. In doubt they are: most sentences about motion mean the side."""
_SIDES = re.compile(
    rf"\b(?:{_IDIOMS})\b"
    r"|\b(?P<side>left|right)"
    r"(?P<end>(?:wards?|most|hand|handed|handedly|hander|foot|footed)?(?:'s|s)?)\b",
    re.IGNORECASE,
)
_TURNS = re.compile(r"\b(?P<counter>(?:counter|anti)[- ]?)?(?P<turn>clockwise)\b", re.IGNORECASE)


def mirror_text(text: str, *, release_compat: bool = False) -> str:
    """Return a sentence with left and right, and the two senses of rotation, exchanged.

    Args:
        text: The sentence.
        release_compat: Exchange substrings as the public release does.
    """
    if release_compat:
        parts = re.sub("left|right", lambda m: {"left": "right", "right": "left"}[m[0]], text)
        return parts.replace("clockwise", "counterclockwise")
    text = _SIDES.sub(_exchange_side, text)
    return _TURNS.sub(_exchange_turn, text)


def _exchange_side(match: re.Match[str]) -> str:
    side = match["side"]
    if side is None:
        return match[0]
    return _in_case_of(side, "right" if side.lower() == "left" else "left") + match["end"]


def _exchange_turn(match: re.Match[str]) -> str:
    if match["counter"] is None:
        return _in_case_of(match["turn"], "counterclockwise")
    return _in_case_of(match[0], "clockwise")


def _in_case_of(model: str, word: str) -> str:
    if model.isupper():
        return word.upper()
    return word.capitalize() if model[:1].isupper() else word


_PERSON = (
    r"(?:person|one|man|woman|boy|girl|guy|dancer|player|fighter|boxer|partner|actor|performer"
    r"|human|individual|friend|character|participant|robot)"
)
_ORDINAL = re.compile(rf"\b(first|second)\b(?P<named>\s+(?:[a-z]+\s+)?{_PERSON}\b)?", re.IGNORECASE)
_BARE = re.compile(
    r"\bthe\s+(first|second)\b"
    r"(?!\s+(?:time|step|half|round|beat|move|hit|punch|kick|part|place|few|two|three|moment)\b)",
    re.IGNORECASE,
)
_NUMBER = re.compile(rf"\b{_PERSON}\s+#?(one|two|1|2|a|b)\b", re.IGNORECASE)
_LETTER = re.compile(r"\b([AB])\b")
_COUNTERPART = {
    **{"first": "second", "second": "first", "one": "two", "two": "one"},
    **{"1": "2", "2": "1", "a": "b", "b": "a"},
}


def swap_text(text: str) -> str:
    """Return a sentence with the roles of first and second person exchanged.

    *The first man*, *person two*, *person A*; *the first* alone where the sentence also has *the
    second*; letters A and B where it has both. Anything else stays: what is said of two people
    without naming them holds for both orders.
    """
    ordinals = [m.span(1) for m in _ORDINAL.finditer(text) if m["named"]]
    numbers = [m.span(1) for m in _NUMBER.finditer(text)]
    letters = [m.span(1) for m in _LETTER.finditer(text)]
    bare = [m.span(1) for m in _BARE.finditer(text)]

    roles = {*ordinals, *bare}
    swapped = roles if len({text[i:j].lower() for i, j in roles}) == 2 else {*ordinals}
    # "person a" may be the start of "the person a step away": small letters count as a pair only.
    pair = {"a", "b"} <= {text[i:j] for i, j in numbers}
    swapped |= {(i, j) for i, j in numbers if pair or text[i:j] not in ("a", "b")}
    if len({text[i:j] for i, j in letters}) == 2:
        swapped |= {*letters}
    for start, end in sorted(swapped, reverse=True):
        word = text[start:end]
        text = text[:start] + _in_case_of(word, _COUNTERPART[word.lower()]) + text[end:]
    return text
