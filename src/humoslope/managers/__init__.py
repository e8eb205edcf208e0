"""The managers: each turns configured terms into one part of the environment step."""

from humoslope.managers.action import ActionManager, JointPositionActionCfg
from humoslope.managers.clock import control_steps
from humoslope.managers.command import CommandManager, VelocityCommandCfg, commanded_and_walked
from humoslope.managers.curriculum import CurriculumManager, CurriculumTerm
from humoslope.managers.event import EventManager, EventTermCfg
from humoslope.managers.finite import FiniteWatch
from humoslope.managers.log import Log
from humoslope.managers.observation import (
    ObservationGroup,
    ObservationGroupCfg,
    ObservationManager,
    ObservationTermCfg,
)
from humoslope.managers.observer import ObserverManager
from humoslope.managers.reward import RewardManager, RewardTermCfg
from humoslope.managers.termination import TerminationManager, TerminationTermCfg
from humoslope.managers.terms import StatefulTerm, TermCfg, Terms

__all__ = [
    "ActionManager",
    "CommandManager",
    "CurriculumManager",
    "CurriculumTerm",
    "EventManager",
    "EventTermCfg",
    "FiniteWatch",
    "JointPositionActionCfg",
    "Log",
    "ObservationGroup",
    "ObservationGroupCfg",
    "ObservationManager",
    "ObservationTermCfg",
    "ObserverManager",
    "RewardManager",
    "RewardTermCfg",
    "StatefulTerm",
    "TermCfg",
    "TerminationManager",
    "TerminationTermCfg",
    "Terms",
    "VelocityCommandCfg",
    "commanded_and_walked",
    "control_steps",
]
