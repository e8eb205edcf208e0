"""Stand-ins end at once, so that nobody needs to wait for them."""

from __future__ import annotations

import pytest

from humoslope.campaign import run


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "POLL_S", 0.001)
