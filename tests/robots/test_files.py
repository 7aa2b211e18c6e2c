from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import stat
import struct
import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from robots.errors import MotionFileError
from robots.files import (
    MAX_DIRECTORY_BYTES,
    parse_npy,
    read_archive,
    sha256,
    whole_file,
    write_archive,
    write_json,
)

DTYPES = st.one_of(
    hnp.floating_dtypes(), hnp.integer_dtypes(), hnp.unsigned_integer_dtypes(), hnp.boolean_dtypes()
)
ARRAYS = hnp.arrays(DTYPES, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5))
JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=10),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc"), inner, max_size=3),
    max_leaves=8,
)


def npy(array) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asarray(array), allow_pickle=False)
    return buffer.getvalue()


def npy_with_header(shape: str, descr: str = "'<f8'", body: bytes = b"") -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + body


def test_a_file_appears_only_when_its_block_ends(tmp_path):
    path = tmp_path / "deep" / "x.bin"
    with whole_file(path) as file:
        file.write(b"half")
        assert not path.exists()
    assert path.read_bytes() == b"half"


def write_and_fail(path, error: BaseException) -> None:
    with whole_file(path) as file:
        file.write(b"new")
        raise error


@pytest.mark.parametrize("error", [KeyError("stop"), KeyboardInterrupt()])
def test_a_failing_block_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "x.bin"
    path.write_bytes(b"old")
    with pytest.raises(type(error)):
        write_and_fail(path, error)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failing_block_leaves_no_new_file(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        write_and_fail(tmp_path / "x.bin", KeyboardInterrupt())
    with pytest.raises(MotionFileError, match="disk is full"):
        write_and_fail(tmp_path / "x.bin", OSError(28, "disk is full"))
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_says_so(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(MotionFileError, match=r"cannot be written.*-o"),
        whole_file(tmp_path / "file" / "x"),
    ):
        pass
    (tmp_path / "folder").mkdir()
    with pytest.raises(MotionFileError, match="cannot be written"), whole_file(tmp_path / "folder"):
        pass
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


def test_files_get_the_users_usual_permissions(tmp_path):
    with whole_file(tmp_path / "x") as file:
        file.write(b"x")
    (tmp_path / "y").touch()
    modes = [stat.S_IMODE(os.stat(tmp_path / name).st_mode) for name in "xy"]
    assert modes[0] == modes[1]


def test_json_is_written_whole_and_without_nan(tmp_path):
    write_json(tmp_path / "x.json", {"a": [1, "ü"]})
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": [1, "ü"]}
    with pytest.raises(ValueError):
        write_json(tmp_path / "y.json", float("nan"))
    assert not (tmp_path / "y.json").exists()


def test_sha256_is_that_of_the_bytes(tmp_path):
    (tmp_path / "x").write_bytes(b"abc")
    assert sha256(tmp_path / "x") == hashlib.sha256(b"abc").hexdigest()
    with pytest.raises(MotionFileError, match="cannot be read"):
        sha256(tmp_path / "y")


@settings(max_examples=60, deadline=None)
@given(
    header=st.dictionaries(st.text("abc"), JSON, max_size=4),
    arrays=st.dictionaries(st.sampled_from(["a", "b.c", "d/e"]), ARRAYS, max_size=3),
)
def test_an_archive_comes_back_exactly_and_deterministically(tmp_path_factory, header, arrays):
    folder = tmp_path_factory.mktemp("archive")
    write_archive(folder / "one.npz", header, arrays)
    write_archive(folder / "two.npz", dict(reversed(header.items())), arrays)
    assert (folder / "one.npz").read_bytes() == (folder / "two.npz").read_bytes()
    read_header, read_arrays = read_archive(folder / "one.npz")
    assert read_header == header
    assert read_arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        assert read_arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(read_arrays[name], np.atleast_1d(array).reshape(array.shape))


def test_a_foreign_archive_has_no_header(tmp_path):
    np.savez_compressed(tmp_path / "x.npz", a=np.arange(3))
    header, arrays = read_archive(tmp_path / "x.npz")
    assert header is None
    np.testing.assert_array_equal(arrays["a"], [0, 1, 2])


@settings(max_examples=60, deadline=None)
@given(array=ARRAYS, fortran=st.booleans())
def test_an_array_comes_back_exactly(array, fortran):
    array = np.asfortranarray(array) if fortran else array
    back = parse_npy(npy(array), where="x")
    assert back.dtype == array.dtype
    assert back.shape == array.shape
    np.testing.assert_array_equal(back, array)
    assert back.flags.writeable


@pytest.mark.parametrize(
    "data",
    [
        npy_with_header("(1000000000000,)"),
        npy_with_header("(0, 1000000000000000000000)"),
        npy_with_header("(-1, -1)", body=b"x" * 8),
        npy_with_header("(True,)", body=b"x" * 8),
        npy_with_header("(" + "1," * 70 + ")", body=b"x" * 8),
        npy_with_header("(10000000000,)", "'<U0'"),
        npy_with_header("(3,)", "'|S0'"),
        npy_with_header("(1,)", "'|O'", b"x" * 8),
        npy_with_header("(1,)", "[('a', '<f8')]", b"x" * 8),
        npy_with_header("(1,)", "'<c16'", b"x" * 16),
        npy_with_header("(1,)", "'<M8[s]'", b"x" * 8),
        npy_with_header("(1,)", "'<U1'", b"\xff\xff\xff\x7f"),
        npy_with_header("(1,)", "'>U1'", b"\x7f\xff\xff\xff"),
        npy_with_header("(1,)", "'<f8'", b"x" * 7),
        npy_with_header("(1,)", "'<f8'", b"x" * 9),
        npy_with_header("__import__('os').getcwd()"),
        b"\x93NUMPY\x03\x00",
        b"\x93NUMPY\x01\x00\xff\xff{",
        b"",
        pickle.dumps([1, 2]),
    ],
)
def test_a_lying_or_foreign_array_is_refused(data):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(MotionFileError):
            parse_npy(data, where="x")


def test_text_arrays_are_read_in_both_byte_orders():
    for order in "<>":
        array = np.array(["é", "𝄞x"]).astype(f"{order}U2")
        np.testing.assert_array_equal(parse_npy(npy(array), where="x"), ["é", "𝄞x"])


class _Trap:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was opened",))


def test_pickles_are_never_opened(tmp_path):
    (tmp_path / "x.npz").write_bytes(pickle.dumps(_Trap()))
    with pytest.raises(MotionFileError, match="pickle"):
        read_archive(tmp_path / "x.npz")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        np.savez(tmp_path / "x.npz", a=np.array([_Trap()], dtype=object))
    with pytest.raises(MotionFileError, match="objects would need pickle"):
        read_archive(tmp_path / "x.npz")


def test_missing_empty_and_foreign_files_say_so(tmp_path):
    with pytest.raises(MotionFileError, match="no such file"):
        read_archive(tmp_path / "x.npz")
    (tmp_path / "x.npz").touch()
    with pytest.raises(MotionFileError, match="empty"):
        read_archive(tmp_path / "x.npz")
    (tmp_path / "x.npz").write_bytes(b"MZ....")
    with pytest.raises(MotionFileError, match="not an npz archive"):
        read_archive(tmp_path / "x.npz")
    with pytest.raises(MotionFileError):
        read_archive(tmp_path)


def refused_within(path, limit: int) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(MotionFileError):
            read_archive(path)
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_other_compressions_are_refused(tmp_path, method):
    """LZMA takes the dictionary size that its header claims, up to gigabytes, and raises its own
    exception, which is neither an OSError nor a ValueError, on damaged data."""
    with zipfile.ZipFile(tmp_path / "x.npz", "w", method) as archive:
        archive.writestr("a.npy", npy(np.zeros(3)))
    with pytest.raises(MotionFileError, match="compressed"):
        read_archive(tmp_path / "x.npz")
    data = bytearray((tmp_path / "x.npz").read_bytes())
    data[44] ^= 0xFF
    (tmp_path / "x.npz").write_bytes(data)
    refused_within(tmp_path / "x.npz", 2**20)


def test_a_directory_with_countless_members_is_not_loaded(tmp_path):
    """Python keeps some 600 bytes for each 46 bytes of a zip's directory."""
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        for i in range(30_000):
            archive.writestr(f"{i}", b"")
    assert (tmp_path / "x.npz").stat().st_size > MAX_DIRECTORY_BYTES
    refused_within(tmp_path / "x.npz", 2**20)


def test_a_zip64_directory_is_refused(tmp_path):
    """Its true size stands in a second record, which would let it claim anything."""
    write_archive(tmp_path / "x.npz", {}, {})
    data = (tmp_path / "x.npz").read_bytes()
    end = data.rfind(b"PK\5\6")
    (tmp_path / "x.npz").write_bytes(data[:end] + b"PK\6\7" + bytes(16) + data[end:])
    with pytest.raises(MotionFileError, match="directory"):
        read_archive(tmp_path / "x.npz")


def test_an_archive_with_a_comment_is_read(tmp_path):
    write_archive(tmp_path / "x.npz", {"a": 1}, {})
    with zipfile.ZipFile(tmp_path / "x.npz", "a") as archive:
        archive.comment = b"made by hand"
    assert read_archive(tmp_path / "x.npz")[0] == {"a": 1}


def test_the_bound_counts_all_members_together(tmp_path):
    write_archive(tmp_path / "x.npz", {}, {"a": np.zeros(100), "b": np.zeros(100)})
    assert len(read_archive(tmp_path / "x.npz", max_bytes=2500)[1]) == 2
    with pytest.raises(MotionFileError, match="MiB"):
        read_archive(tmp_path / "x.npz", max_bytes=1700)


@pytest.mark.parametrize("header", [b"[]", b"{", b"[" * 100_000, b"\xff", b"1" * 5000])
def test_a_header_that_is_no_json_object_is_refused(tmp_path, header):
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("header.json", header)
    with pytest.raises(MotionFileError, match="header"):
        read_archive(tmp_path / "x.npz")


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_a_damaged_archive_gives_itself_or_a_motion_file_error(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damage")
    write_archive(folder / "x.npz", {"a": 1}, {"x": np.arange(6.0), "n": np.array(["p", "q"])})
    content = bytearray((folder / "x.npz").read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, max(len(content) - 1, 0)))
        kind = data.draw(st.sampled_from(["flip", "cut", "insert"]))
        if kind == "cut":
            del content[at:]
        elif kind == "insert":
            content[at:at] = data.draw(st.binary(min_size=1, max_size=30))
        elif content:
            content[at] ^= data.draw(st.integers(1, 255))
    (folder / "x.npz").write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            _, arrays = read_archive(folder / "x.npz")
        except MotionFileError:
            return
    assert sum(array.nbytes for array in arrays.values()) < 10_000
