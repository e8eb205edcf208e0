"""What a drill found."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Drill:
    """A drill: so many faults were injected, and these were not borne as they must be.

    Attributes:
        name: What was done.
        tried: Number of faults.
        failures: A line for each that was not borne.
        seen: How often each answer was seen.
    """

    name: str
    tried: int = 0
    failures: list[str] = field(default_factory=list)
    seen: dict[str, int] = field(default_factory=dict)

    def add(self, answer: str, failure: str = "") -> None:
        """Counts a fault and its answer; a text in `failure` says how the answer was wrong."""
        self.tried += 1
        self.seen[answer] = self.seen.get(answer, 0) + 1
        if failure:
            self.failures.append(failure)
