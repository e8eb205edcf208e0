"""The managers: each turns a list of configured terms into one part of the environment step."""

from humoslope.managers.action import ActionManager, JointPositionAction
from humoslope.managers.command import CommandManager, VelocityCommand
from humoslope.managers.curriculum import CurriculumManager
from humoslope.managers.event import EventManager, EventTerm
from humoslope.managers.log import Log
from humoslope.managers.observation import ObservationGroup, ObservationManager, ObservationTerm
from humoslope.managers.reward import RewardManager, RewardTerm
from humoslope.managers.termination import TerminationManager, TerminationTerm
from humoslope.managers.terms import StatefulTerm, Term, Terms

__all__ = [
    "ActionManager",
    "CommandManager",
    "CurriculumManager",
    "EventManager",
    "EventTerm",
    "JointPositionAction",
    "Log",
    "ObservationGroup",
    "ObservationManager",
    "ObservationTerm",
    "RewardManager",
    "RewardTerm",
    "StatefulTerm",
    "Term",
    "TerminationManager",
    "TerminationTerm",
    "Terms",
    "VelocityCommand",
]
