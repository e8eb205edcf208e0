"""What every test rests on: one CPU thread, no deadlines, and the registered terrains and tasks."""

from __future__ import annotations

import pytest
import torch
from hypothesis import settings

from humoslope.registry import load_content

torch.set_num_threads(1)
settings.register_profile("humoslope", deadline=None, max_examples=50)  # no test depends on how fast the machine is
settings.load_profile("humoslope")


@pytest.fixture(scope="session", autouse=True)
def _content() -> None:
    load_content()
