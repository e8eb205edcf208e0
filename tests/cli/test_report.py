"""`humoslope report`: one page that needs no other file, with what there is, and with the command for what is
missing."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import shutil
import time
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from torch.utils.tensorboard import SummaryWriter

from humoslope.cli import main
from humoslope.evaluation.causes import SLIP, TIP
from humoslope.evaluation.margins import show
from humoslope.evaluation.report.curve import PANELS, STEPS
from humoslope.evaluation.report.page.page import _success
from humoslope.evaluation.report.page.parts import find_policies
from humoslope.learning import checkpoint
from tests import browser
from tests.evaluation import made_up

SECTIONS = ("overview", "configuration", "curves", "ramps", "track", "figures", "walks", "margins", "provenance")
VOID = ("meta", "img", "br", "hr", "link", "input")


class Page(HTMLParser):
    """The tags, the text and the pictures of a page; fails if it is not well-formed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def assert_stands_alone(page: Page) -> None:
    """Nothing is loaded: no script, no style sheet, and every address is a picture in the page or a place in it."""
    assert not {"script", "link", "iframe", "object", "embed", "video", "source"} & {tag for tag, _ in page.tags}
    for tag, attributes in page.tags:
        for name in ("src", "srcset", "href", "data", "action", "background", "poster"):
            value = attributes.get(name)
            assert value is None or value.startswith("#" if tag == "a" else "data:image/png;base64,"), (tag, value)
    assert "url(" not in page.text
    assert "@import" not in page.text
    for image in page.of("img"):
        source = image["src"]
        assert source is not None
        assert base64.b64decode(source.partition(",")[2]).startswith(b"\x89PNG")
        assert image["alt"]


def ramps(sha256: str, **protocol: Any) -> dict[str, Any]:
    """A result of `humoslope ramps` that was never measured."""
    found = [
        {"grade": grade, "falls": {"count": i, "total": 8, "low": 0.0, "high": 0.6}, "speed": 0.45, "speed_error": 0.05}
        | {"root_height": 0.7}
        for i, grade in enumerate((-20.0, 0.0, 20.0))
    ]
    asked = {"speed": 0.5, "seconds": 20.0} | protocol
    return {"what": "ramps", "checkpoint": {"sha256": sha256}, "protocol": asked, "ramps": found, "code": "commit r"}


def margins(sha256: str, **changes: Any) -> dict[str, Any]:
    """A certificate that was never earned."""
    tested = [
        {"value": value, "holds": holds, "trials": 60, "successes": n, "falls": 60 - n, "share_at_least": n / 66.0}
        for value, holds, n in ((5.0, True, 60), (6.0, False, 40))
    ]
    quantity = {
        "meaning": "mass",
        "unit": "kg",
        "grid": [0.0, 5.0, 6.0],
        "limit": 5.0,
        "first_failing": 6.0,
        "monotone": True,
    }
    return {
        "what": "margins",
        "policy": {"task": made_up.TASK, "sha256": sha256},
        "rule": {"share": 0.95, "confidence": 0.95},
        "success": "stays up",
        "reference": tested[0] | {"value": 0.0},
        "quantities": {"load": quantity | {"tested": tested}},
        "model": None,
    } | changes


@pytest.fixture
def run(untrained: Path, tmp_path: Path) -> Path:
    """A run folder with curves and two starts, and nothing measured of it."""
    folder = tmp_path / "first run"
    folder.mkdir()
    shutil.copy(untrained, folder)
    writer = SummaryWriter(str(folder))
    for i in range(30):
        writer.add_scalar(STEPS, 12288.0 * (i + 1), i)
        for panel in PANELS:
            writer.add_scalar(panel.tag, i / 30.0, i)
    writer.close()
    for number, options in enumerate(("--env.num-envs 4", "--agent.max-iterations 9 <b>"), start=1):
        start = folder / "starts" / str(number)
        start.mkdir(parents=True)
        (start / "start.json").write_text(json.dumps({"task": "T", "time": "now", "total_steps": 0, "from": None}))
        (start / "options.txt").write_text(options)
        (start / "git.txt").write_text("commit abc")
    return folder


def measure(run: Path, folder: Path) -> None:
    """Puts every kind of result of the run's checkpoint into a folder, and some of another checkpoint."""
    sha256 = hashlib.sha256((run / "model_0.pt").read_bytes()).hexdigest()
    of_ours = [
        {"task": made_up.TASK, "total_steps": 1, "harness": 0.0, "iteration": 0, "ancestor": None, "sha256": sha256}
    ]
    track = made_up.report(checkpoints=of_ours, code="commit t")
    track["grades"][3]["causes"] = {SLIP: 17, TIP: 4}
    made_up.write(folder, "a", track)
    made_up.write(folder, "b", made_up.sweep(27.0, checkpoints=of_ours))
    made_up.write(folder, "c", ramps(sha256))
    made_up.write(folder, "stand", ramps(sha256, speed=0.0))  # newer, and not what is shown
    made_up.write(folder, "d", margins(sha256))
    made_up.write(folder, "e", ramps("0" * 64))
    (folder / "broken.json").write_text('{"what": ')
    header = {"checkpoint": {"sha256": sha256}}
    np.savez(folder / "walk.npz", header=np.array(json.dumps(header)))


def made(run: Path, *options: str) -> Page:
    out = run.parent / "page.html"
    assert main(["report", str(run), "--out", str(out), *options]) == 0
    page = Page(out.read_text(encoding="utf-8"))
    assert_stands_alone(page)
    assert [section["id"] for section in page.of("section")] == list(SECTIONS)
    return page


def test_what_is_missing_is_said_with_the_command_that_makes_it(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = made(run)
    assert f"wrote {run.parent / 'page.html'}" in capsys.readouterr().out.replace("\n", "")
    path = f"'{run / 'model_0.pt'}'"
    for verb in ("ramps", "evaluate", "record", "export"):
        assert f"humoslope {verb} {path}" in page.text
    assert f"humoslope evaluate {path} --sweep" in page.text
    assert "&& humoslope margins" in page.text
    assert len(page.of("img")) == 1  # the curves
    # The configuration of the checkpoint, where it departs from its task.
    assert "agent.hidden_dims" in page.text
    assert "[24, 16]" in page.text
    assert "env.num_envs" in page.text
    assert "env.rewards" not in page.text
    assert "options: --agent.max-iterations 9 <b>" in page.text  # as text, not as a tag
    assert hashlib.sha256((run / "model_0.pt").read_bytes()).hexdigest() in page.text


def test_everything_that_was_measured_is_shown(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measure(run, run)
    drawn: list[Path] = []

    def draw(rollout: Path, path: Path) -> None:
        drawn.append(rollout)
        Image.new("RGB", (30, 20), (200, 30, 30)).save(path, format="PNG")

    monkeypatch.setattr("humoslope.cli.report._draw_sheet", draw)
    page = made(run)
    assert drawn == [run / "walk.npz"]
    captions = [image["alt"] for image in page.of("img")]
    assert len(captions) == 8  # curves, ramps, four of the track, the walk, margins
    assert "first run: walk.npz, at even intervals." in captions
    assert not [1 for a in page.tags if a[1].get("class") == "missing"]
    assert "3 of 24" in page.text  # falls on ramps
    assert "paper: Ours" in page.text
    assert "max grade" in page.text
    assert SLIP in page.text
    assert "holds to" in page.text
    assert "commit t" in page.text
    assert str(run / "broken.json") in page.text


def test_the_overview_marks_the_rates_of_a_partial_evaluation() -> None:
    report = made_up.report()
    of_policy = SimpleNamespace(results={"held-out": report})
    whole = _success(of_policy)  # type: ignore[arg-type]
    assert whole.startswith("100.0 % at 0°, ")
    of_policy.results["held-out"] = report | {"finished": 40}
    assert _success(of_policy) == f"{whole} (partial)"  # type: ignore[arg-type]


def test_margins_on_another_robot_or_of_fewer_quantities_do_not_stand_for_the_policy(run: Path, tmp_path: Path) -> None:
    """Whatever was written last."""
    sha256 = hashlib.sha256((run / "model_0.pt").read_bytes()).hexdigest()
    whole = margins(sha256)
    load = whole["quantities"]["load"]
    both = {"quantities": {"load": load, "delay": load}}
    elsewhere = made_up.write(tmp_path, "elsewhere", margins(sha256, model="h1.xml", **both))
    (policy,) = find_policies([str(run)], [elsewhere])
    assert policy.results["margins"]["model"] == "h1.xml"  # there is no other one
    shown = show.table(policy.results["margins"])
    assert shown.title == "Margins on another robot, h1.xml"
    assert "examined on another robot, h1.xml; holds: " in str(shown.caption)
    own, few = made_up.write(tmp_path, "own", margins(sha256, **both)), made_up.write(tmp_path, "few", whole)
    for newest, path in enumerate((own, elsewhere, few), start=1):
        os.utime(path, (newest, newest))
    (policy,) = find_policies([str(run)], [tmp_path])
    assert policy.results["margins"] == json.loads(own.read_text())
    assert show.table(policy.results["margins"]).title == "Margins"


def test_results_elsewhere_belong_to_a_checkpoint_by_its_hash_and_runs_are_compared(run: Path, tmp_path: Path) -> None:
    elsewhere, other = tmp_path / "results", tmp_path / "other"
    elsewhere.mkdir()
    other.mkdir()
    sha256 = hashlib.sha256((run / "model_0.pt").read_bytes()).hexdigest()
    made_up.write(elsewhere, "anything", ramps(sha256))
    state = checkpoint.load(run / "model_0.pt")
    state["config"]["env"]["seed"] = 77
    checkpoint.save(other / "model_3.pt", state | {"iteration": 3})
    out = tmp_path / "both.html"
    sources = [f"ours={run}", f"theirs={other / 'model_3.pt'}"]
    assert main(["report", *sources, "--also", str(elsewhere), "--out", str(out), "--no-pictures"]) == 0
    page = Page(out.read_text(encoding="utf-8"))
    assert_stands_alone(page)
    assert "theirs: falls and speed on ramps have not been measured" in page.text
    assert "ours: falls" not in page.text
    assert "theirs: there are no curves" in page.text
    assert re.search(r"env\.seed\s*1\s*1\s*77", page.text)


def test_mistakes_are_said_in_one_sentence(mistake: Callable[..., str], run: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert "needs a run folder or a checkpoint" in mistake("report")
    assert "does not exist" in mistake("report", str(tmp_path / "nowhere"))
    assert "checkpoint" in mistake("report", str(tmp_path / "empty"))
    assert "does not exist" in mistake("report", str(run), "--also", str(tmp_path / "nowhere"))
    assert "must end in .html" in mistake("report", str(run), "--out", str(tmp_path / "page.pdf"))
    assert "two called" in mistake("report", str(run), f"first run={run}")


@pytest.mark.skipif(browser.CHROMIUM is None, reason="needs Chromium (Debian: chromium)")
def test_a_headless_browser_shows_every_picture_and_asks_for_nothing(run: Path, tmp_path: Path) -> None:
    measure(run, run)
    made(run, "--no-pictures")
    with browser.page(tmp_path) as call:

        def value(script: str) -> Any:
            return call("Runtime.evaluate", expression=script)["result"].get("value")

        call("Page.navigate", url=(run.parent / "page.html").as_uri())
        until = time.monotonic() + browser.PATIENCE_S
        while value("document.readyState") != "complete" or not value("document.images.length"):
            assert time.monotonic() < until
            time.sleep(0.2)
        assert value("[...document.images].every(i => i.complete && i.naturalWidth > 100)")
        assert value("document.images.length") == 7
        assert value("performance.getEntriesByType('resource').every(r => r.name.startsWith('data:'))")
        assert value("document.querySelectorAll('section').length") == len(SECTIONS)
        assert value("getComputedStyle(document.body).maxWidth") != "none"  # its own styles are allowed
        # No wider than the window, so that a page on a small screen scrolls in one direction.
        assert value("document.documentElement.scrollWidth <= window.innerWidth")
        picture = base64.b64decode(call("Page.captureScreenshot")["data"])
    assert picture.startswith(b"\x89PNG")
