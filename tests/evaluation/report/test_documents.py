"""The numbers in README and documentation are those of the shipped result files.

Tables are found by their header, and claims by their words, in any of the documents; so they may move between files. If
a claim is rephrased or dropped, change it here too.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from humoslope.evaluation.report.paper import read_paper
from humoslope.evaluation.report.results import Result, read_results
from humoslope.statistics import Average, Proportion

ROOT = Path(__file__).parents[3]
RESULTS = ROOT / "experiments" / "results"
PAGES = [path for path in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in path.parts]
DOCUMENTS = [ROOT / "README.md", *PAGES, ROOT / "experiments" / "log.md"]
STAGES = {"Stage I": "stage1", "Stage II": "stage2", "URL-TerrainRelative": "url"}
GRADES = (0.0, 10.0, 20.0, 30.0)

Table = list[dict[int, str]]


@cache
def text() -> str:
    """All documents, with single spaces between words."""
    return re.sub(r"\s+", " ", "\n".join(path.read_text(encoding="utf-8") for path in DOCUMENTS if path.is_file()))


@cache
def tables() -> list[list[list[str]]]:
    """Every Markdown table as rows of cells, without emphasis; its header first."""
    found: list[list[list[str]]] = []
    for path in DOCUMENTS:
        inside = False
        for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
            row = line.strip()
            if not row.startswith("|"):
                inside = False
                continue
            cells = [cell.strip().strip("*").replace("`", "") for cell in row.strip("|").split("|")]
            if not inside:
                found.append([])
                inside = True
            if not all(re.fullmatch(r":?-+:?", cell) for cell in cells):
                found[-1].append(cells)
    return found


def table(*header: str) -> list[list[str]]:
    """Rows below the header that begins with these cells, of every table that has it."""
    rows = [row for found in tables() if tuple(found[0][: len(header)]) == header for row in found[1:]]
    assert rows, f"no document has a table with the header {header}"
    return rows


@cache
def report(name: str) -> dict[str, Any]:
    return json.loads((RESULTS / f"{name}.json").read_text())


@cache
def result(stage: str) -> Result:
    """Trials on the track and sweep of a method."""
    return read_results([f"x={RESULTS / kind / stage}.json" for kind in ("heldout", "sweep")])[0]


def mean(stage: str, grade: float, name: str) -> Average:
    figure = result(stage).at(grade).summary[name]  # type: ignore[union-attr]
    assert isinstance(figure, Average)
    return figure


def success(stage: str, grade: float) -> Proportion:
    figure = result(stage).at(grade).summary["success"]  # type: ignore[union-attr]
    assert isinstance(figure, Proportion)
    return figure


def stage_of(cell: str) -> str:
    return STAGES[cell.split(",", maxsplit=1)[0]]


# Tables


def test_the_ramps_table_is_that_of_its_result() -> None:
    rows = table("grade", "falls", "95 % interval", "mean speed m/s", "error m/s", "pelvis height m")
    expected = [
        [
            f"{r['grade']:+g}°",
            f"{r['falls']['count']}/{r['falls']['total']}",
            f"{100 * r['falls']['low']:.1f} to {100 * r['falls']['high']:.1f} %",
            *(f"{r[name]:.3f}" for name in ("speed", "speed_error", "root_height")),
        ]
        for r in sorted(report("stage1_ramps")["ramps"], key=lambda r: r["grade"])
    ]
    assert rows == expected


def test_the_held_out_table_is_that_of_its_results_and_of_the_paper() -> None:
    rows = table("method", "0° SR %", "T_trav s", "10° SR %")
    paper = {row.name: row for row in read_paper().main}
    seen = []
    for name, *cells in rows:
        seen.append(name.split(",")[0])
        if name == "at the commanded speed":
            times = [result("stage1").setup.commanded_seconds(grade) for grade in GRADES]  # type: ignore[union-attr]
            expected = [cell for seconds in times for cell in ("", f"{seconds:.1f}")] + [""]
        elif name.startswith("paper: "):
            row = paper[name.removeprefix("paper: ")]
            figures = [row.grades[grade][key] for grade in GRADES for key in ("sr", "t_trav")]
            expected = ["-" if figure is None else f"{figure:.1f}" for figure in figures] + [f"{row.max_grade:g}°"]
        else:
            stage = stage_of(name)
            expected = []
            for grade in GRADES:
                rate, time = success(stage, grade), result(stage).at(grade).summary["traversal_s"]  # type: ignore[union-attr]
                expected.append(f"{100 * rate.share:.1f} ({100 * rate.low:.0f}-{100 * rate.high:.0f})")
                expected.append(f"{time.mean:.1f}" if isinstance(time, Average) else "-")
            expected.append(f"{result(stage).limit:g}°")
            steps = " + ".join(f"{n / 1e6:.3g}" for n in result(stage).training[0].steps)
            assert f"{steps} M steps" in name
        assert cells == expected, name
    assert {"at the commanded speed", *STAGES, *(f"paper: {method}" for method in paper)} == set(seen)


def test_the_table_of_policies_from_outside_is_that_of_their_results() -> None:
    rows = table("policy from outside", "0° SR %", "MXD m")
    for (name, *cells), file in zip(rows, ("ppo", "fastsac"), strict=True):
        assert name.lower() == f"holosoma, {file}"
        found = read_results([f"x={RESULTS / 'outside' / f'holosoma-{file}'}.json"])[0]
        expected = []
        for grade in GRADES:
            rate, way = (found.at(grade).summary[key] for key in ("success", "max_distance"))  # type: ignore[union-attr]
            assert isinstance(rate, Proportion)
            assert isinstance(way, Average)
            assert (rate.total, way.trials) == (48, 48)
            expected += [f"{100 * rate.share:.1f} ({100 * rate.low:.0f}-{100 * rate.high:.0f})", f"{way.mean:.1f}"]
        assert cells == expected, name


def test_the_short_table_of_the_readme_says_the_same() -> None:
    rows = table("method", "0°", "10°", "20°", "30°", "steepest")
    paper = {row.name: row for row in read_paper().main}
    for name, *cells in rows:
        if name.startswith("paper: "):
            row = paper.pop(name.removeprefix("paper: "))
            expected = [f"{row.grades[grade]['sr']:.1f}" for grade in GRADES] + [f"{row.max_grade:g}°"]
        else:
            shares = [100.0 * success(stage_of(name), grade).share for grade in GRADES]
            expected = [f"{share:.1f}" for share in shares] + [f"{result(stage_of(name)).limit:g}°"]
        assert cells == expected, name
    assert not paper
    assert {row[0] for row in rows} >= set(STAGES)


def test_the_posture_table_is_that_of_its_results_and_of_the_paper() -> None:
    rows = table("", "CoM height m: 0°", "10°", "20°", "30°")
    paper = {f"paper: {row.name}": row.grades[20.0] for row in read_paper().ablation}
    for name, *cells in rows:
        if name in paper:
            figures = paper[name]
            own = [figures[key] for key in ("com_height", "cot", "yaw_rate_variance", "knee_peak")]
            assert cells == ["", "", f"{own[0]:.3f}", "", f"{own[1]:.2f}", f"{own[2]:.3f}", f"{own[3]:.0f}"], name
            continue
        stage = STAGES[name]
        heights = [f"{mean(stage, grade, 'com_height').mean:.3f}" for grade in GRADES]
        cost = result(stage).at(20.0).summary["cost_of_transport"]  # type: ignore[union-attr]
        yaw, knee = (mean(stage, 20.0, metric).mean for metric in ("yaw_rate_variance", "knee_peak"))
        shown = [cell.removesuffix(", falling") for cell in cells]
        assert shown == [*heights, f"{cost:.2f}", f"{yaw:.3f}", f"{knee:.0f}"], name
    assert set(STAGES) <= {row[0] for row in rows}


def test_the_speed_table_is_that_of_its_result() -> None:
    rows = table("envs", "raw physics", "env.step", "of raw", "PPO loop", "of raw", "peak memory")
    expected = []
    for size in report("bench")["sizes"]:
        raw, step, loop = (median(size[name]) for name in ("raw", "env", "ppo"))
        # Rounds alternate, so shares are those of each round.
        shares = [median(a / b for a, b in zip(size[name], size["raw"], strict=True)) for name in ("env", "ppo")]
        expected.append(
            [
                f"{size['num_envs']}",
                f"{raw:,.0f}/s",
                f"{step:,.0f}/s",
                f"{100 * shares[0]:.0f}%",
                f"{loop:,.0f}/s",
                f"{100 * shares[1]:.0f}%",
                f"{size['peak_mib']:,.0f} MiB",
            ]
        )
    assert rows == expected


def test_the_table_of_standing_robots_is_that_of_its_results() -> None:
    rows = table("commanded to stand", "grade", "falls", "creep along, across m/s", "drift m", "steps 1/s")
    expected = []
    for name in ("Stage I", "Stage II"):
        for r in sorted(report(f"{STAGES[name]}_stand")["ramps"], key=lambda r: r["grade"]):
            s = r["standing"]
            creep = f"{s['creep_along']:.3f}, {s['creep_across']:.3f}"
            falls = f"{r['falls']['count']}/{r['falls']['total']}"
            steps = f"{s['touchdowns_per_s']:.1f}"
            expected.append([name, f"{r['grade']:+g}°", falls, creep, f"{s['drift']:.2f}", steps])
    assert rows == expected


# Claims in sentences


def largest_margin(name: str, grades: dict[str, tuple[float, ...]]) -> float:
    return max(
        margin.high - margin.mean
        for stage, own in grades.items()
        for grade in own
        if isinstance(margin := result(stage).at(grade).summary[name], Average) and margin.high is not None  # type: ignore[union-attr]
    )


def successes(stage: str, grade: float) -> int:
    return next(c["summary"]["success"]["count"] for c in report(f"sweep/{stage}")["cells"] if c["grade"] == grade)


def least_and_most(stage: str, low: float, high: float) -> tuple[int, int]:
    counts = [successes(stage, grade) for grade in range(round(low), round(high) + 1)]
    return min(counts), max(counts)


def by_friction(stage: str) -> list[str]:
    cells = [c["summary"]["success"] for c in report(f"heldout/{stage}")["cells"] if c["grade"] == 20.0]
    return [f"{100 * c['count'] / c['total']:.0f}" for c in cells]


def com_difference(grade: float) -> float:
    """CoM height of Stage II less that of Stage I, mm."""
    return 1e3 * (mean("stage2", grade, "com_height").mean - mean("stage1", grade, "com_height").mean)


def flexion(stage: str, direction: str) -> float:
    diagnosis = result(stage).at(20.0).diagnosis[direction]  # type: ignore[union-attr]
    assert diagnosis is not None
    return math.degrees(diagnosis.knee_flexion)


def cost(stage: str) -> float:
    return float(result(stage).at(20.0).summary["cost_of_transport"])  # type: ignore[union-attr, arg-type]


def drift(stage: str) -> str:
    level = next(r for r in report(f"{stage}_stand")["ramps"] if r["grade"] == 0.0)
    return f"{level['standing']['drift']:.2f}"


ALL = dict.fromkeys(STAGES.values(), GRADES)

CLAIMS: dict[str, Callable[[], list[str]]] = {
    r"Student's for T_trav is at most ±(\d\.\d+) s": lambda: [f"{largest_margin('traversal_s', ALL):.2f}"],
    r"Stage II's (\S+) s at 20° and (\S+) s at 30° are over-speed \((\S+) and (\S+) m/s": lambda: [
        *(f"{mean('stage2', grade, 'traversal_s').mean:.1f}" for grade in (20.0, 30.0)),
        *(f"{mean('stage2', grade, 'speed').mean:.3f}" for grade in (20.0, 30.0)),
    ],
    r"A success ends a trial at (\S+) m here": lambda: [f"{result('stage1').goal:g}"],
    r"Stage I makes all of (\d+) up to (\d+)° and none from (\d+)° on": lambda: [
        f"{least_and_most('stage1', 10, 34)[0]}",
        f"{result('stage1').limit:g}",
        f"{result('stage1').limit + 1 + least_and_most('stage1', 35, 40)[1]:g}",  # type: ignore[operator]
    ],
    r"Stage II at least (\d+) of (\d+) at each degree up to (\d+)° and none at (\d+)°": lambda: [
        f"{least_and_most('stage2', 10, 39)[0]}",
        f"{report('sweep/stage2')['protocol']['trials']}",
        f"{result('stage2').limit:g}",
        f"{40 + successes('stage2', 40)}",
    ],
    r"The baseline makes (\d+) of 32 at 23°, (\d+) at 24°, (\d+) at 26° and none from (\d+)° on": lambda: [
        *(f"{successes('url', grade)}" for grade in (23, 24, 26)),
        f"{27 + least_and_most('url', 27, 40)[1]}",
    ],
    r"grip helps it: (\d+), (\d+) and (\d+) % at 20° with rising friction": lambda: by_friction("url"),
    r"which for the CoM heights are at most ±(\S+) mm, and ±(\S+) mm for the baseline at 30°": lambda: [
        f"{1e3 * largest_margin('com_height', ALL | {'url': GRADES[:3]}):.1f}",
        f"{1e3 * largest_margin('com_height', {'url': (30.0,)}):.1f}",
    ],
    r"\*\*taller only at 30 degrees\*\*, by (\d) mm; level at 20 and (\d) to (\d) mm lower on 0 and 10": lambda: [
        f"{com_difference(30.0):.0f}",
        *sorted(f"{-com_difference(grade):.0f}" for grade in (0.0, 10.0)),
    ],
    r"its knees are flexed (\d) degrees more all along the track": lambda: [
        f"{sum(flexion('stage2', d) - flexion('stage1', d) for d in ('up', 'flat', 'down')) / 3:.0f}"
    ],
    r"In the paper it goes at (\S+) m and there is something to be mended; here it goes at (\S+) m": lambda: [
        f"{next(r for r in read_paper().ablation if r.name == 'Stage I only').grades[20.0]['com_height']:.3f}",
        f"{mean('stage1', 20.0, 'com_height').mean:.3f}",
    ],
    r"on level ground Stage I drifts (\S+) m and Stage II (\S+) m": lambda: [drift("stage1"), drift("stage2")],
    r"without a fall in (\d+) starts each": lambda: [
        f"{report(f'{stage}_stand')['ramps'][0]['falls']['total']}" for stage in ("stage1",)
    ],
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_a_claim_with_numbers_is_that_of_the_results(claim: str) -> None:
    found = re.search(claim, text())
    assert found is not None, "the sentence is gone or rephrased: change its claim here too"
    assert list(found.groups()) == CLAIMS[claim]()


def test_claims_in_words_hold() -> None:
    # "a third more energy", "ten degrees straighter uphill", "faster than Stage I at every grade, most of all at 30"
    assert cost("stage2") / cost("stage1") == pytest.approx(4.0 / 3.0, abs=0.02)
    assert flexion("stage1", "up") - flexion("url", "up") == pytest.approx(10.0, abs=1.0)
    gains = [mean("stage2", grade, "speed").mean - mean("stage1", grade, "speed").mean for grade in GRADES]
    assert min(gains) > 0.0
    assert max(gains) == gains[3]
    # "Stage I is too slow at every grade"
    assert all(mean("stage1", grade, "speed").high < 0.5 for grade in GRADES)  # type: ignore[operator]
    # "Nobody fell", "step on the spot about four times a second"
    standing = [r for stage in ("stage1", "stage2") for r in report(f"{stage}_stand")["ramps"]]
    assert not any(r["falls"]["count"] for r in standing)
    assert all(3.5 < r["standing"]["touchdowns_per_s"] < 4.5 for r in standing)
