"""`--help` of every verb shows each option with its type or choices and a sentence on what it means."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from humoslope.cli import VERBS, main

TASK = "HumoSlope-Stage2-Unitree-G1"
COMMANDS = [
    *([verb] for verb in VERBS if verb not in ("train", "bench", "check")),
    *([verb, TASK] for verb in ("train", "bench", "check")),
]
NO_SENTENCE = re.compile(r"^(Of|What|How|Which|Whether|Where|When|Who|That) ")


def printed_options(text: str) -> dict[str, str]:
    """Help by the invocation of each option, such as "--seed INT", from boxes that stand one below another."""
    found: dict[str, str] = {}
    for box in re.findall(r"^╭─ .*?─╮\n(.*?)^╰─", text, re.MULTILINE | re.DOTALL):
        lines = [line.removeprefix("│").removesuffix("│").rstrip() for line in box.splitlines()]
        rules = [i for i, line in enumerate(lines) if line.startswith(" ──")]  # below the description of the group
        name = ""
        for line in lines[rules[-1] + 1 if rules else 0 :]:
            if not line.startswith("  "):
                # The help may stand beside the option, and the negative form of a flag stands below it.
                invocation, _, beside = line.strip().partition("  ")
                name = f"{name} {invocation}" if name.endswith(",") else invocation
                found[name] = beside.strip()
            else:
                found[name] = f"{found[name]} {line.strip()}".strip()
    return {name: text for name, text in found.items() if not name.endswith(",")}


def help_of(command: list[str]) -> str:
    out = io.TextIOWrapper(
        io.BytesIO(), encoding="utf-8"
    )  # as of a terminal: where only ASCII can be said are no boxes
    with redirect_stdout(out), pytest.raises(SystemExit) as ended:
        main([*command, "--help"])
    assert ended.value.code == 0
    out.seek(0)
    return out.read()


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_every_option_has_a_type_and_a_sentence(command: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = help_of(command)
    assert f"humoslope {' '.join(command)}" in text
    assert "Attributes:" not in text
    assert "Args:" not in text
    assert "fixed" not in text
    options = printed_options(text)
    assert any(name.startswith("-h") for name in options)
    for name, said in options.items():
        if name.startswith("-h"):
            continue
        flag = re.match(r"--[\w.-]+, --([\w.-]*\.)?no-[\w-]+$", name)
        assert flag or re.match(r"(--[\w.-]+ )?\[*([A-Z]+|\{.+\})", name), f"{name} has no type"
        sentence = re.sub(r"\s*\((default|required|optional|repeatable|fixed)[^()]*(\([^()]*\))*[^()]*\)$", "", said)
        assert len(sentence.split()) >= 2, f"{name} has no help"
        assert sentence[0].isupper() or sentence[0] in "\"'", f"{name}: {sentence}"
        assert sentence.endswith("."), f"{name}: {sentence}"
        assert not NO_SENTENCE.match(sentence), f"{name}: {sentence}"


def test_help_does_not_look_for_what_the_run_would_start_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    walker = tmp_path / "logs" / "HumoSlope-Stage1-Unitree-G1" / "run" / "model_1.pt"
    walker.parent.mkdir(parents=True)
    walker.touch()  # not calibrated, and no checkpoint at all
    monkeypatch.chdir(tmp_path)
    assert "--agent.gamma" in help_of(["train", TASK])
