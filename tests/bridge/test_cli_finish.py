"""``pasdedeux finish``, and which generator takes which option."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.spoiling import spoil
from bridge.cli import main
from generator.choreographer import choreograph
from generator.io import read_motion, write_motion


@pytest.fixture(scope="module")
def spoilt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("finish") / "spoilt.npz"
    write_motion(spoil(choreograph("handshake", seed=0), seed=0), path)
    return path


def skate(path: Path) -> float:
    """Return the mean speed of points that are labelled as standing, m/s."""
    motion, speeds = read_motion(path), []
    for person in motion.people:
        assert person.foot_contacts is not None
        feet = person.keypoints[:, [7, 10, 8, 11]]
        speed = np.linalg.norm(np.diff(feet, axis=0), axis=-1) * motion.fps
        speeds.append(speed[person.foot_contacts[1:] & person.foot_contacts[:-1]])
    return float(np.concatenate(speeds).mean())


def test_a_motion_file_is_finished_and_what_changed_is_told(spoilt, tmp_path, capsys) -> None:
    out = tmp_path / "new" / "clean.npz"
    assert main(["finish", str(spoilt), "-o", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    before, after = read_motion(spoilt), read_motion(out)
    assert (before.fps, after.fps) == (15, 30)
    assert (after.text, after.licence, after.source) == (before.text, before.licence, before.source)
    assert facts["licence"] == before.licence
    changes = facts["finishing"]
    assert changes["fps_before"] == 15
    assert changes["touches"] == len(before.contacts) > 0
    assert changes["missing"] < 0.005 < changes["missed"]
    assert skate(out) < 0.3 * skate(spoilt)
    assert main(["finish", str(spoilt), "-o", str(out), "--no-feet", "--rate", "20"]) == 0
    assert "keypoints moved by" in capsys.readouterr().out
    assert read_motion(out).fps == 20
    assert skate(out) > 0.5 * skate(spoilt), "feet were held although that was turned off"


def test_touches_that_are_named_are_closed(spoilt, tmp_path, capsys) -> None:
    out = tmp_path / "clean.npz"
    plain = tmp_path / "plain.npz"
    motion = read_motion(spoilt)
    np.savez(plain, keypoints=motion.keypoints, fps=motion.fps, up="z")
    touch = ["--touch", "right_hand:right_hand"]
    assert main(["finish", str(plain), "-o", str(out), *touch, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [(c["a"], c["b"]) for c in facts["contacts"]] == [("right_hand", "right_hand")]
    assert facts["finishing"]["missing"] < 0.005
    for wrong, said in (
        (["--touch", "right_hand"], "A:B"),
        (["--touch", "tail:nose"], "tail"),
        (["--rate", "0"], "frames per second"),
        (["--smoothing", "-1"], "smoothing"),
        (["--rotations", "1.5"], "rotations"),
    ):
        assert main(["finish", str(plain), "-o", str(out), *wrong]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "able"),
    [
        (("choreographer", "--then", "they bow"), "--generator diffusion"),
        (("choreographer", "--seconds", "3"), "--generator diffusion or --generator intergen"),
        (("choreographer", "--round", "they bow"), "--generator intergen"),
        (("intergen", "--tempo", "1.2"), "choreographer or --generator diffusion"),
        (("intergen", "--nearest"), "choreographer or --generator diffusion"),
        (("diffusion", "--given", "m.npz"), "--generator intergen"),
    ],
)
def test_an_option_that_a_generator_does_not_take_is_refused(
    options, able, tmp_path, capsys
) -> None:
    out = tmp_path / "m.npz"
    assert main(["generate", "two people wave", "-o", str(out), "--generator", *options]) == 2
    assert able in capsys.readouterr().err
    assert not out.exists()


def test_the_choreographer_takes_numbers_of_the_manner(tmp_path, capsys) -> None:
    words = ["generate", "two people bow", "--generator", "choreographer"]

    def seconds(*options: str) -> float:
        out = str(tmp_path / "m.npz")
        assert main([*words, "-o", out, *options, "--json"]) == 0
        return json.loads(capsys.readouterr().out)["seconds"]

    assert seconds("--tempo", "1.4") < 0.85 * seconds() < 0.85**2 * seconds("--speed", "0.7")
    assert main([*words, "-o", str(tmp_path / "m.npz"), "--tempo", "9"]) == 2
    assert "0.6 to 1.4" in capsys.readouterr().err
