"""What a user who installs the wheel gets, away from any checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = {"robots", "generator", "sim", "bridge"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", str(folder), ROOT]
    subprocess.run(command, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*command, "--target", str(folder), str(wheel)], check=True)
    return folder


def run_outside(installed: Path, folder: Path, *code: str) -> subprocess.CompletedProcess[str]:
    env = os.environ | {"PYTHONPATH": str(installed)}
    return subprocess.run(
        [sys.executable, *code], cwd=folder, env=env, capture_output=True, text=True, check=False
    )


def test_wheel_holds_the_four_packages_and_nothing_else(wheel: Path) -> None:
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == PACKAGES


def test_wheel_holds_every_tracked_data_file(wheel: Path) -> None:
    listed = subprocess.run(
        ["git", "ls-files", *PACKAGES], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("not a git checkout, so the tracked files are unknown")
    assert set(listed.stdout.split()) - set(zipfile.ZipFile(wheel).namelist()) == set()


def test_installed_wheel_generates_a_duet_outside_the_checkout(
    installed: Path, tmp_path: Path
) -> None:
    code = "import sys, bridge.cli; print(bridge.__file__); sys.exit(bridge.cli.main(sys.argv[1:]))"
    done = run_outside(
        *(installed, tmp_path, "-c", code, "generate", "they shake hands", "-o", "m.npz"),
        *("--generator", "choreographer"),
    )
    assert done.returncode == 0, done.stderr
    assert str(installed) in done.stdout
    assert (tmp_path / "m.npz").stat().st_size > 10_000


def test_a_shadowing_module_is_named(installed: Path, tmp_path: Path) -> None:
    """A user's own sim.py next to the script used to be imported in place of ours."""
    (tmp_path / "sim.py").write_text("")
    code = "import sys, bridge.cli; sys.exit(bridge.cli.main(['robots']))"
    done = run_outside(installed, tmp_path, "-c", code)
    assert done.returncode == 2
    assert str(tmp_path / "sim.py") in done.stderr
    assert "Traceback" not in done.stderr


def test_help_loads_neither_torch_nor_physics_nor_serial(tmp_path: Path) -> None:
    heavy = "{'torch', 'mujoco', 'mink', 'onnxruntime', 'serial', 'dynamixel_sdk', 'av'}"
    code = (
        "import sys, bridge.cli\n"
        "try: bridge.cli.main(['--help'])\n"
        f"finally: print(sorted({heavy} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "[]"
    assert "doctor" in done.stdout
