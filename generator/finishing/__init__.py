"""Makes the motion of any generator clean: rigid bones, still feet, no jitter, hands that meet.

Torch-free. ``finish(motion)`` returns the :class:`~generator.motion.DuetMotion` at 30 frames per
second; ``finish_with_changes(motion)`` also what was changed.
"""

from generator.finishing.finish import Changes, finish, finish_with_changes
from generator.finishing.settings import DRAWN, Finishing
from generator.finishing.touches import Meeting

__all__ = ["DRAWN", "Changes", "Finishing", "Meeting", "finish", "finish_with_changes"]
