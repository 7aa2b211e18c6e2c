"""Motion files: every format is read by one module, and one type comes out.

:func:`read_motion` reads any known format, :func:`write_motion` writes the project's own,
:func:`write_bvh` writes for animation tools. ``docs/motion-files.md`` has the table of formats.
"""

from generator.io.archive import SCHEMA as MOTION_SCHEMA
from generator.io.archive import write_motion
from generator.io.bvh_writer import write_bvh
from generator.io.reader import read_motion

__all__ = ["MOTION_SCHEMA", "read_motion", "write_bvh", "write_motion"]
