"""Files that lie, are cut, or are garbage: only MotionFileError comes out, in bounded memory."""

from __future__ import annotations

import io
import shutil
import struct
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from generator.io import read_motion, write_bvh, write_motion
from robots.errors import MotionFileError
from robots.files import read_archive, write_archive
from robots.skeleton import human_skeleton

MIB = 2**20

Sample = tuple[Path, list[str], str, dict]
"""Folder, names of the files that may be damaged, what is read, and what the caller says."""

ASF = """:units
 length 0.45
 angle deg
:root
 order TX TY TZ RX RY RZ
 axis XYZ
 position 0 0 0
 orientation 0 0 0
:bonedata
{bones}:hierarchy
 begin
{tree} end
"""


def _asf() -> str:
    def bone(name: str, vector: tuple[float, float, float], dof: str = "rx") -> str:
        size = float(np.linalg.norm(vector))
        unit = " ".join(f"{c / size:.4f}" for c in vector)
        return (
            f" begin\n  name {name}\n  direction {unit}\n  length {size / 0.056444:.4f}\n"
            f"  axis 0 0 0 XYZ\n  dof {dof}\n end\n"
        )

    chains: dict[str, list[tuple[str, tuple[float, float, float]]]] = {"": [
        (n, (0, 0.1, 0)) for n in ("lowerback", "upperback", "thorax", "lowerneck", "upperneck",
                                   "head")]}  # fmt: skip
    for side, x in (("l", 1), ("r", -1)):
        chains[side + "leg"] = [
            (side + "hipjoint", (0.1 * x, -0.09, 0)), (side + "femur", (0, -0.42, 0)),
            (side + "tibia", (0, -0.42, 0)), (side + "foot", (0, -0.05, 0.14)),
            (side + "toes", (0, 0, 0.05))]  # fmt: skip
        chains[side + "arm"] = [
            (side + "clavicle", (0.18 * x, 0.05, 0)), (side + "humerus", (0.28 * x, 0, 0)),
            (side + "radius", (0.27 * x, 0, 0)), (side + "hand", (0.1 * x, 0, 0))]  # fmt: skip
    bones, tree = "", ""
    for key, chain in chains.items():
        parent = "thorax" if key.endswith("arm") else "root"
        for name, vector in chain:
            bones += bone(name, vector)
            tree += f"  {parent} {name}\n" if parent not in ("root", "thorax") else ""
            parent = name
    tree += "  root lowerback lhipjoint rhipjoint\n  thorax lowerneck lclavicle rclavicle\n"
    tree = tree.replace("  thorax lowerneck\n", "", 1)
    return ASF.format(bones=bones, tree=tree)


def _amc(x: float) -> str:
    names = [line.split()[1] for line in _asf().splitlines() if line.startswith("  name")]
    frame = f"root {x} 17 0 0 0 0\n" + "".join(f"{name} 3\n" for name in names)
    return ":FULLY-SPECIFIED\n:DEGREES\n" + "".join(f"{n}\n{frame}" for n in (1, 2, 3))


@pytest.fixture(scope="module")
def samples(make_duet, tmp_path_factory) -> dict[str, Sample]:
    """One small valid file or pair of every format."""
    root = tmp_path_factory.mktemp("samples")
    motion = make_duet(frames=3)
    points = motion.keypoints.astype(np.float32)

    def folder(name: str) -> Path:
        (root / name).mkdir()
        return root / name

    plain = {"fps": 30, "up": "z"}
    found: dict[str, Sample] = {}
    write_motion(motion, folder("own") / "m.npz")
    found["own"] = (root / "own", ["m.npz"], "m.npz", {})
    np.save(folder("npy") / "m.npy", points)
    found["npy"] = (root / "npy", ["m.npy"], "m.npy", plain)
    np.savez(folder("npz") / "m.npz", joints=points)
    found["npz"] = (root / "npz", ["m.npz"], "m.npz", plain)
    np.savez(folder("named") / "m.npz", a=points[:, 0], b=points[:, 1], fps=30.0, up="z",
             joint_names=np.array(human_skeleton().names), parents=np.arange(22))  # fmt: skip
    found["named"] = (root / "named", ["m.npz"], "m.npz", {})
    place = folder("smplx")
    for letter, person in (("a", 0), ("b", 1)):
        np.savez_compressed(
            place / f"m_{letter}.npz", global_joint_positions=points[:, person], height=1.7
        )
    found["smplx"] = (place, ["m_a.npz", "m_b.npz"], "m_a.npz", {"fps": 30})
    place = folder("interhuman")
    for person in (0, 1):
        (place / f"person{person + 1}").mkdir()
        rows = np.zeros((3, 492), np.float32)
        rows[:, :66] = points[:, person].reshape(3, 66)
        np.save(place / f"person{person + 1}" / "7.npy", rows)
    found["interhuman"] = (place, ["person1/7.npy", "person2/7.npy"], "person1/7.npy", {})
    write_bvh(motion, folder("bvh"))
    found["bvh"] = (root / "bvh", ["a.bvh", "b.bvh"], "a.bvh", {"scale": 0.01})
    place = folder("acclaim")
    (place / "18.asf").write_text(_asf())
    shutil.copy(place / "18.asf", place / "19.asf")
    (place / "18_01.amc").write_text(_amc(-9))
    (place / "19_01.amc").write_text(_amc(9))
    found["acclaim"] = (place, ["18.asf", "19_01.amc"], "18_01.amc", {})
    return found


FORMATS = ["own", "npy", "npz", "named", "smplx", "interhuman", "bvh", "acclaim"]


@pytest.mark.parametrize("name", FORMATS)
def test_the_undamaged_samples_are_read(samples, name):
    folder, _, path, said = samples[name]
    assert read_motion(folder / path, **said).frames == 3


Damage = Callable[[bytes], bytes]


@st.composite
def damages(draw) -> Damage:
    """Flip, cut, insert, repeat, or exchange tokens, at places given as shares of the file."""
    kind = draw(st.sampled_from(["flip", "cut", "insert", "repeat", "token", "drop"]))
    places = draw(st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=4))
    payload = draw(st.binary(min_size=1, max_size=8))
    token = draw(
        st.sampled_from(
            [b"nan", b"inf", b"-1", b"1e308", b"1e999", b"{", b"}", b"", b"99999999999999999999",
             b"\xff\xfe", b"\x00", "é".encode("latin-1"), b"JOINT", b"begin", b"end", b"1_0"]
        )
    )  # fmt: skip

    def apply(data: bytes) -> bytes:
        out = bytearray(data)
        for place in places:
            if not out:
                break
            at = int(place * len(out))
            if kind == "flip":
                out[at] ^= payload[0] or 1
            elif kind == "cut":
                del out[at:]
            elif kind == "insert":
                out[at:at] = payload
            elif kind == "repeat":
                out[at:at] = out[at : at + 200]
            elif kind == "drop":
                del out[at : at + len(payload)]
            else:
                start = max(out.rfind(b" ", 0, at), out.rfind(b"\n", 0, at)) + 1
                ends = [e for e in (out.find(b" ", at), out.find(b"\n", at)) if e >= 0]
                out[start : min(ends, default=len(out))] = token
        return bytes(out)

    return apply


@pytest.mark.parametrize("name", FORMATS)
@settings(
    max_examples=50,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(damage=damages(), which=st.integers(0, 1))
def test_a_damaged_file_gives_a_motion_or_a_motion_file_error(
    samples, tmp_path, name, damage, which
):
    folder, targets, path, said = samples[name]
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    target = tmp_path / targets[which % len(targets)]
    target.write_bytes(damage(target.read_bytes()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numpy's own remarks on broken headers
        try:
            motion = read_motion(tmp_path / path, **said)
        except MotionFileError:
            return
    assert np.isfinite(motion.keypoints).all()
    assert motion.a.rotations is not None


@pytest.mark.parametrize("suffix", ["npz", "npy", "bvh", "amc"])
@settings(max_examples=40, deadline=None)
@given(data=st.binary(max_size=400))
def test_noise_gives_a_motion_file_error(tmp_path_factory, suffix, data):
    folder = tmp_path_factory.mktemp("noise")
    for letter in "ab":
        (folder / f"x_{letter}.{suffix}").write_bytes(data)
    with pytest.raises(MotionFileError):
        read_motion(folder / f"x_a.{suffix}", fps=30, up="z", scale=1)


CONTENTS = st.one_of(
    hnp.arrays(
        st.one_of(
            hnp.floating_dtypes(),
            hnp.integer_dtypes(),
            hnp.boolean_dtypes(),
            hnp.complex_number_dtypes(),
            hnp.unicode_string_dtypes(max_len=3),
            hnp.byte_string_dtypes(max_len=3),
        ),
        st.one_of(
            hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=3),
            st.sampled_from([(3, 22, 3), (3, 2, 22, 3), (3, 22, 4), (3, 4), (22, 3), (22,)]),
        ),
    ),
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(["a", "b", "start", "end", "gap"]), inner, max_size=5),
    max_leaves=10,
)  # fmt: skip


@pytest.mark.parametrize("name", ["own", "npz", "named", "smplx"])
@settings(
    max_examples=50,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_an_intact_archive_with_wrong_content_gives_a_motion_or_a_motion_file_error(
    samples, tmp_path, name, data
):
    """Flipped bits rarely pass the checksum of a zip; wrong content does."""
    folder, targets, path, said = samples[name]
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    header, arrays = read_archive(folder / targets[0])
    kind = data.draw(st.sampled_from(["replace", "remove", "add", "header"]))
    if kind == "header" and header:
        key = data.draw(st.sampled_from(sorted(header)))
        header[key] = data.draw(JSON)
    else:
        key = data.draw(st.sampled_from([*sorted(arrays), "fps", "up", "text", "foot_contacts_a"]))
        if kind == "remove":
            arrays.pop(key, None)
        else:
            arrays[key] = data.draw(CONTENTS)
    if header is None:
        np.savez(tmp_path / targets[0], **arrays)  # pyright: ignore[reportArgumentType]
    else:
        write_archive(tmp_path / targets[0], header, arrays)
    try:
        motion = read_motion(tmp_path / path, **said)
    except MotionFileError:
        return
    assert motion.a.rotations is not None
    write_motion(motion, tmp_path / "again.npz")


def peak(action: Callable[[], object]) -> int:
    """Return the most memory, in bytes, that a refused reading takes."""
    tracemalloc.start()
    try:
        with pytest.raises(MotionFileError):
            action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def npy_header(shape: str, descr: str = "<f8") -> bytes:
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (63 - (len(text) + 10) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


@pytest.mark.parametrize(
    "shape", ["(1000000000, 2, 22, 3)", "(100000000000000, 492)", "(0, 2, 22, 3)", "(-1, 2, 22, 3)"]
)
def test_a_header_that_claims_terabytes_takes_no_memory(tmp_path, shape):
    (tmp_path / "x.npy").write_bytes(npy_header(shape) + b"\0" * 64)
    assert peak(lambda: read_motion(tmp_path / "x.npy", fps=30, up="z")) < MIB
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("joints.npy", npy_header(shape) + b"\0" * 64)
    assert peak(lambda: read_motion(tmp_path / "x.npz", fps=30, up="z")) < MIB


def test_a_zip_bomb_is_not_inflated(tmp_path):
    with (
        zipfile.ZipFile(tmp_path / "x.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("joints.npy", "w", force_zip64=True) as member,
    ):
        for _ in range(300):
            member.write(b"\0" * MIB)
    assert (tmp_path / "x.npz").stat().st_size < MIB
    assert peak(lambda: read_motion(tmp_path / "x.npz", fps=30, up="z")) < MIB


def test_a_zip_bomb_that_lies_about_its_size_is_cut_off(tmp_path):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("joints.npy", b"\0" * (64 * MIB))
    data = buffer.getvalue().replace(struct.pack("<I", 64 * MIB), struct.pack("<I", 1000))
    (tmp_path / "x.npz").write_bytes(data)
    assert peak(lambda: read_motion(tmp_path / "x.npz", fps=30, up="z")) < 4 * MIB


def test_small_numbers_do_not_grow_beyond_the_bound(tmp_path):
    """An int8 array becomes eight times as large as floats."""
    np.savez_compressed(tmp_path / "x.npz", joints=np.zeros((99_999, 2, 22, 3), np.int8))
    taken = peak(lambda: read_motion(tmp_path / "x.npz", fps=30, up="z"))
    assert taken < 700 * MIB
    np.save(tmp_path / "x.npy", np.zeros((2_000_000, 2, 22, 3), bool)[:100_001])
    assert peak(lambda: read_motion(tmp_path / "x.npy", fps=30, up="z")) < 64 * MIB


def test_a_bvh_with_a_billion_frames_takes_no_memory(samples, tmp_path):
    folder, _, path, said = samples["bvh"]
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    text = (tmp_path / path).read_text()
    for claim in ("1000000000", "100000", "9" * 30):
        (tmp_path / path).write_text(text.replace("Frames: 3", f"Frames: {claim}"))
        assert peak(lambda: read_motion(tmp_path / path, **said)) < 2 * MIB


def test_a_deeply_nested_bvh_is_refused_without_recursion(tmp_path):
    nest = "".join(f"JOINT j{i}\n{{\nOFFSET 0 0 0\nCHANNELS 0\n" for i in range(50_000))
    text = "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 0\n" + nest
    (tmp_path / "x_a.bvh").write_text(text)
    (tmp_path / "x_b.bvh").write_text(text)
    with pytest.raises(MotionFileError, match="too many joints"):
        read_motion(tmp_path / "x_a.bvh", scale=0.01)


def test_an_endless_line_is_not_swallowed(tmp_path):
    for letter in "ab":
        (tmp_path / f"x_{letter}.bvh").write_bytes(b"HIERARCHY" + b"x" * (8 * MIB))
    assert peak(lambda: read_motion(tmp_path / "x_a.bvh", scale=1)) < 4 * MIB


def test_a_huge_text_file_is_refused_unread(tmp_path):
    for letter in "ab":
        with open(tmp_path / f"x_{letter}.bvh", "wb") as file:
            file.truncate(300 * MIB)  # sparse: takes no space on the disk
    assert peak(lambda: read_motion(tmp_path / "x_a.bvh", scale=1)) < MIB
    with open(tmp_path / "x.npy", "wb") as file:
        file.truncate(300 * MIB)
    assert peak(lambda: read_motion(tmp_path / "x.npy", fps=30, up="z")) < MIB


def test_devices_and_folders_are_no_motion_files(tmp_path):
    for name in ("x.npy", "x.npz", "x.bvh"):
        (tmp_path / name).mkdir()
        with pytest.raises(MotionFileError):
            read_motion(tmp_path / name, fps=30, up="z")
    (tmp_path / "z_a.bvh").symlink_to("/dev/zero")
    (tmp_path / "z_b.bvh").symlink_to("/dev/zero")
    with pytest.raises(MotionFileError, match="ordinary file"):
        read_motion(tmp_path / "z_a.bvh", scale=1)
    (tmp_path / "z.npy").symlink_to("/dev/zero")
    with pytest.raises(MotionFileError, match="ordinary file"):
        read_motion(tmp_path / "z.npy", fps=30, up="z")


def test_texts_that_are_no_unicode_are_refused(samples, tmp_path):
    folder, _, path, said = samples["named"]
    with np.load(folder / path) as archive:
        arrays = dict(archive)
    names = arrays["joint_names"].copy()
    names.view(np.uint32)[3] = 0x7FFFFFFF  # no such character
    for bad in (names, np.array([b"\xff\xfe"] * 22)):
        np.savez(tmp_path / "x.npz", **{**arrays, "joint_names": bad})
        with pytest.raises(MotionFileError, match="Unicode"):
            read_motion(tmp_path / "x.npz", **said)


def test_a_deep_header_is_refused(tmp_path):
    write_archive(tmp_path / "x.npz", {}, {"a": np.zeros(1)})
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("header.json", b"[" * 200_000)
    with pytest.raises(MotionFileError, match="JSON"):
        read_motion(tmp_path / "x.npz")
