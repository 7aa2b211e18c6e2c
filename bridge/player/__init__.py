"""The player: two checked trajectories, two robots, one clock."""

from bridge.gate import Verdict as Verdict
from bridge.player.play import play as play
from bridge.player.settings import PlayerSettings as PlayerSettings
from bridge.stop import StopRequest as StopRequest
