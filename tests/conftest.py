"""Fixtures that several packages' tests share."""

from __future__ import annotations

from pathlib import Path

import hypothesis
import pytest

from sim.gl import choose_backend

choose_backend()  # before any test module imports mujoco

# How long an example takes says more about what else the computer does than about the code.
hypothesis.settings.register_profile(
    "suite", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("suite")


@pytest.fixture(scope="session")
def duets() -> Path:
    """Folder of real motion-capture clips that lies beside a development checkout.

    The clips are not part of the project (their licence forbids reselling them); tests that need
    them are skipped where they are not there.
    """
    folder = Path(__file__).parents[2] / "shared" / "duets"
    if not folder.is_dir():
        pytest.skip(f"no motion-capture clips at {folder}")
    return folder
