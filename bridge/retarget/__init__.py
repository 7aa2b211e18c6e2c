"""Retargeting: two people's motion onto two servo robots."""

from bridge.retarget.retarget import Retargeted as Retargeted
from bridge.retarget.retarget import RetargetSettings as RetargetSettings
from bridge.retarget.retarget import retarget as retarget
