"""The managers: each turns a list of configured terms into one part of the environment step."""

from humoslope.managers.action import ActionManager, JointPositionActionCfg
from humoslope.managers.command import CommandManager, VelocityCommandCfg
from humoslope.managers.curriculum import CurriculumManager
from humoslope.managers.event import EventManager, EventTermCfg
from humoslope.managers.log import Log
from humoslope.managers.observation import ObservationGroupCfg, ObservationManager, ObservationTermCfg
from humoslope.managers.reward import RewardManager, RewardTermCfg
from humoslope.managers.termination import TerminationManager, TerminationTermCfg
from humoslope.managers.terms import StatefulTerm, TermCfg, Terms

__all__ = [
    "ActionManager",
    "CommandManager",
    "CurriculumManager",
    "EventManager",
    "EventTermCfg",
    "JointPositionActionCfg",
    "Log",
    "ObservationGroupCfg",
    "ObservationManager",
    "ObservationTermCfg",
    "RewardManager",
    "RewardTermCfg",
    "StatefulTerm",
    "TermCfg",
    "TerminationManager",
    "TerminationTermCfg",
    "Terms",
    "VelocityCommandCfg",
]
