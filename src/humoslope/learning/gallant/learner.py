"""What Gallant's PPO has beyond that of the other tasks: clipped rewards, and a highest learning rate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from humoslope.learning.learner import Transition
from humoslope.learning.ppo import PpoLearner, WarmStartPpo

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv
    from humoslope.learning.gallant.config import GallantCfg


class GallantLearner(PpoLearner):
    """rsl_rl's PPO with Gallant's network.

    Raises:
        UserError: If a value of the configuration is impossible, or does not fit the environment.
    """

    def __init__(self, env: ManagerBasedRlEnv, cfg: GallantCfg) -> None:
        super().__init__(env, cfg)
        self._only_positive = cfg.only_positive_rewards
        self._remarks = [f"{self.spec.variant} (of the preset 'cpu'): not Gallant's own."] if self.spec.variant else []

    def take(self, transition: Transition) -> None:
        """Puts a step into the rollout, its reward clipped at 0 from below."""
        if self._only_positive:
            transition = transition._replace(reward=transition.reward.clamp(min=0.0))
        super().take(transition)

    def remarks(self) -> list[str]:
        """That the voxel grid is a reduced one, once."""
        remarks, self._remarks = self._remarks, []
        return [f"The voxels are a {remark}" for remark in remarks]


class CappedPpo(WarmStartPpo):
    """PPO whose adaptive rule does not raise the learning rate above a bound."""

    def __init__(self, *args: Any, max_learning_rate: float, **kwargs: Any) -> None:
        self._most = max_learning_rate
        super().__init__(*args, **kwargs)

    @property
    def learning_rate(self) -> float:
        """The present learning rate of actor and critic."""
        return self._learning_rate

    @learning_rate.setter
    def learning_rate(self, value: float) -> None:
        self._learning_rate = min(value, self._most)
