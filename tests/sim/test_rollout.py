import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from generator.motion import Contact, DuetMotion
from robots.errors import MotionFileError, SpecError
from robots.files import read_archive, write_archive
from sim.rollout import Rollout, motion_sha256
from sim.track import TrackSettings, track


@pytest.fixture(scope="module")
def rollout(make_duet):
    base = make_duet(0.4)
    contact = Contact("left_hand", "right_hand", 0.1, 0.2, 0.3)
    return track(replace(base, contacts=(contact,)), settings=TrackSettings(controller="assist"))


def test_a_rollout_survives_its_file(rollout, tmp_path):
    path = tmp_path / "rollout.npz"
    rollout.save(path)
    back = Rollout.load(path)
    for name in ("times", "qpos", "qvel", "ctrl", "assist", "torque", "keypoints", "reference"):
        assert np.array_equal(getattr(back, name), getattr(rollout, name))
    assert back.metadata == json.loads(json.dumps(rollout.metadata))
    assert back.xml == rollout.xml
    assert back.contacts == rollout.contacts
    assert back.fell == rollout.fell


def test_the_same_rollout_gives_the_same_bytes(rollout, tmp_path):
    rollout.save(tmp_path / "a.npz")
    rollout.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_what_was_simulated_becomes_a_motion(rollout):
    motion = rollout.as_motion()
    assert motion.kind == "simulated"
    assert motion.licence == "Apache-2.0"
    assert motion.frames == rollout.frames
    assert np.abs(motion.keypoints - rollout.keypoints[::2]).max() < 1e-9
    assert motion.a.rotations is not None


def test_keypoints_are_those_of_the_scene(rollout):
    assert np.abs(rollout.scene().keypoints(rollout.qpos) - rollout.keypoints).max() < 1e-9


def test_the_hash_tells_motions_apart(make_duet):
    base = make_duet(0.4)
    assert motion_sha256(base) == motion_sha256(make_duet(0.4))
    assert motion_sha256(base) != motion_sha256(DuetMotion(base.b, base.a))
    assert motion_sha256(base) != motion_sha256(make_duet(0.4, fps=25.0))
    assert motion_sha256(base) != motion_sha256(make_duet(0.4, with_rotations=False))
    touch = Contact("left_hand", "right_hand", 0.1, 0.2, 0.3)
    assert motion_sha256(base) != motion_sha256(replace(base, contacts=(touch,)))


def damaged(rollout, path, *, header=None, arrays=None):
    rollout.save(path)
    old_header, old_arrays = read_archive(path)
    assert old_header is not None
    write_archive(path, {**old_header, **(header or {})}, {**old_arrays, **(arrays or {})})
    return path


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"schema": "pasdedeux.motion/1"}, "not a rollout"),
        ({"keypoint_names": ["x"]}, "not those of this version"),
        ({"fps": "fast"}, "incomplete"),
        ({"fps": 0}, "frames at"),
        ({"metadata": {"contacts": [{"a": 1}]}}, "incomplete"),
        ({"metadata": 7}, "incomplete"),
    ],
)
def test_damaged_headers_are_named(rollout, tmp_path, header, message):
    with pytest.raises(MotionFileError, match=message):
        Rollout.load(damaged(rollout, tmp_path / "x.npz", header=header))


@pytest.mark.parametrize("name", ["times", "qpos", "assist", "offsets", "weight", "keypoints"])
def test_damaged_arrays_are_named(rollout, tmp_path, name):
    good = np.array(getattr(rollout, name))
    bad = good.copy()
    bad.flat[0] = np.nan
    for array in (bad, good[..., None], good.astype(str)):
        with pytest.raises(MotionFileError):
            Rollout.load(damaged(rollout, tmp_path / "x.npz", arrays={name: array}))


def test_cut_files_are_refused(rollout, tmp_path):
    path = tmp_path / "x.npz"
    rollout.save(path)
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(MotionFileError):
        Rollout.load(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.json", "{}")
    with pytest.raises(MotionFileError, match="not a rollout"):
        Rollout.load(path)


def test_a_scene_that_opens_files_is_refused(rollout, tmp_path):
    xml = rollout.xml.replace("<worldbody>", '<include file="/etc/passwd"/><worldbody>', 1)
    loaded = Rollout.load(damaged(rollout, tmp_path / "x.npz", header={"xml": xml}))
    with pytest.raises(SpecError, match="include"):
        loaded.scene()
