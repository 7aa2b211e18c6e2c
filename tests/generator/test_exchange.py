"""Two people, each with a gesture of their own: motions, sentences, clips and how they are read."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.generating import make
from generator.choreographer import (
    GESTURES,
    STAND,
    Style,
    examine,
    exchange,
    generate,
    random_bodies,
)
from generator.data import Exchanged
from generator.data.choreographed import TOLD, clauses_of, symmetries
from generator.data.exchanged import drawn_styles, pairs, told, verbs_of
from generator.finishing.meant import meetings_of
from generator.motion import DuetMotion, Motion
from generator.runtime import DiffusionRequest
from generator.runtime.generation import open_studio
from generator.runtime.network import halves
from generator.runtime.repertoire import read
from generator.text import understand
from generator.text.gestures import describe_exchange, duet_with, duet_wording, vocabulary
from generator.text.grammar import ORDINARY, Clause, describe, grammar, manner_words
from generator.text.mentions import mentions
from robots.errors import PromptError, SpecError


def lowest_head(motion: Motion) -> float:
    return float(motion.point("head")[:, 2].min() / motion.point("head")[:, 2].max())


def highest_hand(motion: Motion) -> float:
    """Return how far a hand is above the shoulder at most, m."""
    return max(
        float((motion.point(f"{s}_hand") - motion.point(f"{s}_shoulder"))[:, 2].max())
        for s in ("left", "right")
    )


@pytest.mark.parametrize("name", GESTURES)
def test_every_gesture_goes_with_every_body_style_and_partner(name: str) -> None:
    rng = np.random.default_rng([3, *name.encode()])
    for other in (GESTURES[int(rng.integers(len(GESTURES)))], STAND):
        styles = drawn_styles(rng)
        duet = exchange((name, other), seed=4, styles=styles, skeletons=random_bodies(rng))
        assert examine(duet).faults == ()
        assert duet.interaction == f"{name}+{other}"


def test_one_bows_while_the_other_waves() -> None:
    duet = exchange(("bow", "wave"), seed=1)
    assert lowest_head(duet.a) < 0.96 < lowest_head(duet.b)
    assert highest_hand(duet.a) < 0.0 < highest_hand(duet.b)
    turned = exchange(("bow", "wave"), seed=1, styles=(Style(swap=True), Style(swap=True)))
    np.testing.assert_allclose(turned.b.keypoints, duet.a.keypoints * (-1, -1, 1), atol=1e-9)


def test_each_has_a_manner_of_the_own() -> None:
    deep, slight = Style(amplitude=1.4), Style(amplitude=0.6)
    duet = exchange(("bow", "bow"), seed=2, styles=(deep, slight))
    assert lowest_head(duet.a) < lowest_head(duet.b) - 0.05


def test_who_is_done_first_stands_and_sways_until_the_other_is() -> None:
    duet = exchange(("bow", "disco"), seed=5)
    assert duet.a.frames == duet.b.frames
    last = duet.a.point("head")[-60:]
    assert 0.0 < np.ptp(last[:, :2], axis=0).max() < 0.05


def test_impossible_exchanges_are_refused() -> None:
    with pytest.raises(PromptError, match="no gesture 'handshake'"):
        exchange(("handshake", "wave"))
    with pytest.raises(SpecError, match="another hand"):
        exchange(("bow", "wave"), styles=(Style(), Style(handedness="left")))


@given(st.integers(0, 2**32), st.sampled_from(("train", "test", "sentences", "combinations")))
@settings(max_examples=60, deadline=None)
def test_a_sentence_says_of_each_only_what_they_do(seed: int, split) -> None:
    rng = np.random.default_rng(seed)
    known = pairs(split)
    gestures, styles = known[int(rng.integers(len(known)))], drawn_styles(rng)
    sentence = told(gestures, styles, split, rng)
    named = mentions(sentence.text)
    if named:
        assert (named[0].person == "b") == styles[0].swap, sentence.text
    assert ("left" in sentence.text) <= (styles[0].handedness == "left")
    for said, style, gesture in zip(sentence.said, styles, gestures, strict=True):
        for field in said:
            direction = "low" if getattr(style, field) < ORDINARY[field] else "high"
            words = manner_words(field, direction)
            if field == "amplitude":
                words += vocabulary(gesture).amplitude[direction]
            assert any(word in sentence.text for word in words), (sentence.text, field)
    for field in {*ORDINARY} - {*sentence.said[0], *sentence.said[1]}:
        words = [w for way in ("low", "high") for w in manner_words(field, way)]
        assert not any(f" {word}" in sentence.text for word in words), (sentence.text, field)


def test_pairs_and_wordings_that_are_held_out_are_not_trained_on() -> None:
    assert not set(pairs("train")) & set(pairs("combinations"))
    assert len(pairs("train")) + len(pairs("combinations")) == len(GESTURES) ** 2 - 1
    for gesture in GESTURES:
        known, unseen = (set(verbs_of(gesture, unseen=held)) for held in (False, True))
        assert not known & unseen
        assert known | unseen == set(vocabulary(gesture).verbs)
        assert any(verb.plain for verb in unseen)


def test_a_verb_that_answers_says_so_only_of_the_second() -> None:
    rng = np.random.default_rng(0)
    texts = [describe_exchange(("wave", "bow"), (Style(), Style()), rng).text for _ in range(200)]
    assert any(text.endswith("bows back.") for text in texts)
    assert not any("waves back" in text for text in texts)


def test_clips_of_exchanges_are_functions_of_seed_and_number() -> None:
    clips, again = Exchanged(3, seed=3), Exchanged(130, seed=3)
    np.testing.assert_array_equal(
        clips.clip(2).poses[1].positions, again.clip(2).poses[1].positions
    )
    assert clips.clip(2).texts == again.clip(2).texts
    assert len({again.gestures(i) for i in range(len(pairs("train")))}) == len(pairs("train"))
    given = clips.performance(1)
    assert given.motion.interaction == "+".join(given.gestures)
    assert given.motion.text == given.texts[0]
    assert clips.fingerprint != again.fingerprint
    with pytest.raises(IndexError):
        clips.clip(3)
    with pytest.raises(SpecError, match="count"):
        Exchanged(0)
    with pytest.raises(SpecError, match="split"):
        Exchanged(1, split="trian")  # type: ignore[arg-type]


def test_every_symmetry_of_an_exchange_has_sentences_of_its_own() -> None:
    clips = Exchanged(4, seed=8)
    for index in range(4):
        clip, given = clips.clip(index), clips.performance(index)
        assert clip.symmetric is not None
        for texts, turned in zip(
            (clip.texts, *clip.symmetric), symmetries(given.styles[0]), strict=True
        ):
            assert len(texts) == TOLD
            for text in texts:
                named = mentions(text)
                assert not named or (named[0].person == "b") == turned.swap, text
                assert ("left" in text) <= (turned.handedness == "left"), text


HALVES = [
    ("The first person bows deeply and the other waves back slowly.", ("bow", "wave")),
    ("One person waves and the other ignores them.", ("wave", STAND)),
    ("The second person salutes; the first person blows a kiss.", ("salute", "blow_kiss")),
    ("A bows to B, who waves.", ("bow", "wave")),
    ("A dancer curtsies while the other dancer salutes.", ("curtsy", "salute")),
    ("One dances and the other claps.", ("disco", "applaud")),
    ("Person A snaps a photo and person B keeps still.", ("photograph", STAND)),
]


@pytest.mark.parametrize(("text", "gestures"), HALVES)
def test_both_halves_of_a_sentence_are_understood(text: str, gestures: tuple[str, str]) -> None:
    meaning = understand(text)
    assert meaning.exchange is not None
    assert meaning.exchange.gestures == gestures
    assert meaning.deed == "+".join(gestures)
    assert meaning.known
    assert meaning.exchange.styles[0].swap == text.startswith("The second")
    assert meetings_of(text) == ()


def test_each_half_has_its_adverbs() -> None:
    meaning = understand("the first person bows deeply and the other waves back slowly")
    assert meaning.exchange is not None
    one, other = meaning.exchange.styles
    assert one.amplitude > 1.2 > other.amplitude
    assert other.speed < 0.9 < one.speed
    left = understand("The first person bows and the second waves with the left hand.").exchange
    assert left is not None
    assert [style.handedness for style in left.styles] == ["left", "left"]
    both = understand("the first person bows deeply and the second bows slightly").exchange
    assert both is not None
    assert both.gestures == ("bow", "bow")


@pytest.mark.parametrize(
    "text",
    [
        "The first person bows and the second bows back.",
        "The first person applauds and the second takes a bow.",
        "One throws a ball and the other catches it.",
        "One holds up a palm and the other claps it.",
        "They wave at each other.",
        "A and B dance disco.",
    ],
)
def test_what_the_repertoire_holds_as_one_is_no_exchange(text: str) -> None:
    assert understand(text).exchange is None


def test_hardly_any_wording_of_an_interaction_is_taken_for_an_exchange() -> None:
    rng = np.random.default_rng(0)
    clauses = [(name, clause) for name, entry in grammar().items() for clause in entry.clauses]
    chosen = [clauses[i] for i in rng.permutation(len(clauses))[:200]]
    texts = [describe(name, Style(), rng, clauses=(clause,)).text for name, clause in chosen]
    assert sum(understand(text).exchange is not None for text in texts) <= 3


def test_the_choreographer_and_the_model_s_reader_take_both_halves() -> None:
    text = "the first person bows deeply and the other waves back slowly"
    duet, meaning = generate(text, seed=3)
    assert meaning.exchange is not None
    again = exchange(("bow", "wave"), seed=3, styles=meaning.exchange.styles)
    np.testing.assert_array_equal(duet.a.keypoints, again.a.keypoints)
    assert duet.text == text
    assert read((text,), nearest=False).facts[0]["interaction"] == "bow+wave"
    fast, _ = generate(text, seed=3, style={"speed": 1.4})
    assert isinstance(fast, DuetMotion)
    assert fast.frames < duet.frames


@pytest.mark.parametrize("name", GESTURES)
@pytest.mark.parametrize("swap", [False, True])
def test_a_model_is_asked_for_a_gesture_in_words_that_it_has_learnt(name: str, swap: bool) -> None:
    text = duet_with(name, Style(amplitude=1.4, swap=swap))
    meaning = understand(text)
    assert meaning.exchange is None
    assert meaning.interaction == ("whisper" if name == STAND else name)
    if name == STAND:  # who stands is whispered to
        assert meaning.style.swap != swap
    elif name != "disco":  # both dance
        assert meaning.style.swap == swap
        assert meaning.style.amplitude > 1
    interaction, voice, words = duet_wording(name)
    if name == STAND:
        words = words.format(first="{second}", second="{first}")
    assert Clause(words, voice) in clauses_of(interaction, unseen=False)


@pytest.mark.parametrize(
    ("text", "of_a", "of_b"),
    [
        ("the first person bows deeply and the other waves back slowly", "bow", "wave"),
        ("the second bows, and the first waves", "wave", "bow"),
        ("person B salutes while person A just watches", STAND, "salute"),
    ],
)
def test_each_is_asked_for_a_duet_in_which_they_do_their_part(
    text: str, of_a: str, of_b: str
) -> None:
    reading = read((text, "two people hug"), nearest=False)
    assert list(reading.apart) == [text]
    for said, gesture, second in zip(reading.apart[text], (of_a, of_b), (False, True), strict=True):
        meaning = understand(said)
        stands = gesture == STAND
        assert meaning.interaction == ("whisper" if stands else gesture)
        assert meaning.style.swap == (second != stands)
    if "deeply" in text:
        assert understand(reading.apart[text][0]).style.amplitude > 1
        assert understand(reading.apart[text][1]).style.speed < 1


def test_the_shipped_model_lets_one_bow_and_the_other_wave() -> None:
    """It used to let both wave: it has seen no duet in which each has a gesture of their own."""
    text = "the first person bows deeply and the other waves back slowly"
    for said, bows, waves in ((text, "a", "b"), (text.replace("first", "second"), "b", "a")):
        duet, facts = make(said, generator="diffusion", seed=1)
        assert facts["understood"][0]["interaction"] == "bow+wave"
        assert list(facts["drawn_apart"]) == [said]
        people = {"a": duet.a, "b": duet.b}
        assert lowest_head(people[bows]) < 0.9 < lowest_head(people[waves])
        assert highest_hand(people[bows]) < 0.0 < highest_hand(people[waves])


def test_energy_and_amplitude_are_added_to_what_each_of_the_two_does() -> None:
    text = "the first person bows and the other waves"
    studio = open_studio((text,), DiffusionRequest(energy=1.35))
    steering = studio.steering(text)
    assert steering.other is not None
    assert not np.allclose(steering.other, studio.cond(text))
    first, second = halves(524)
    for accent, mask in zip(steering.accents, (first, second), strict=True):
        np.testing.assert_allclose(accent.weight, mask)
    calm = open_studio((text,), DiffusionRequest()).steering(text)
    assert not calm.accents
    np.testing.assert_array_equal(calm.other, steering.other)
