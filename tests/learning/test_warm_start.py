"""A later stage starts from the actor of the earlier one, and does not ruin it."""

from __future__ import annotations

import torch

from humoslope.cli import main
from humoslope.learning import checkpoint
from humoslope.learning.policy import read_provenance


def moved(before: dict, after: dict, part: str) -> bool:
    """Whether any weight of a network changed between two checkpoints; its normaliser does not count."""
    weights = [
        state["policy"]["weights"] if part == "actor" else state["learner"]["critic_state_dict"]
        for state in (before, after)
    ]
    return any(not torch.equal(w, weights[1][name]) for name, w in weights[0].items() if "normalizer" not in name)


def test_a_held_actor_stays_as_it_is_while_the_critic_learns(train, tmp_path):
    run = train(tmp_path / "held", "--agent.max-iterations", "4", "--agent.critic-warmup-iterations", "2")
    states = [checkpoint.load(run / f"model_{i}.pt") for i in range(4)]
    assert not moved(states[0], states[1], "actor")
    assert moved(states[0], states[1], "critic")
    assert moved(states[1], states[2], "actor")
    rates = [state["learner"]["optimizer_state_dict"]["param_groups"][0]["lr"] for state in states]
    assert rates[1] == 1e-3
    assert rates[2] < 1e-4  # two mini-batches, each of which may raise it by half


def test_a_run_that_is_resumed_while_the_actor_is_held_goes_on_as_if_nothing_had_been(train, task, tmp_path):
    options = ("--agent.critic-warmup-iterations", "2")
    whole = train(tmp_path / "whole", "--agent.max-iterations", "3", *options)
    parts = train(tmp_path / "parts", "--agent.max-iterations", "1", *options)
    assert main(["train", task, "--resume", str(parts), "--agent.max-iterations", "2"]) == 0
    states = [checkpoint.load(run / "model_1.pt") for run in (whole, parts)]
    first = checkpoint.load(whole / "model_0.pt")
    assert not moved(first, states[0], "actor")
    assert not moved(first, states[1], "actor")


def test_a_warm_started_run_has_the_earlier_actor_with_its_normaliser_and_a_new_critic(train, finished, tmp_path):
    source = checkpoint.load(finished / "model_2.pt")
    run = train(
        tmp_path / "later",
        "--init",
        str(finished),
        "--agent.max-iterations",
        "1",
        "--agent.critic-warmup-iterations",
        "1",
    )
    state = checkpoint.load(run / "model_0.pt")
    assert not moved(source, state, "actor")
    assert moved(source, state, "critic")
    count = "obs_normalizer.count"
    assert state["policy"]["weights"][count] > source["policy"]["weights"][count]
    assert state["learner"]["critic_state_dict"][count] < source["learner"]["critic_state_dict"][count]
    assert state["iteration"] == 0


def test_a_checkpoint_tells_what_its_run_started_from_also_after_it_was_resumed(train, task, finished, tmp_path):
    run = train(tmp_path / "later", "--init", str(finished / "model_1.pt"), "--agent.max-iterations", "1")
    assert main(["train", task, "--resume", str(run), "--agent.max-iterations", "2"]) == 0
    for number in range(2):
        parent = read_provenance(run / f"model_{number}.pt").parent
        assert parent is not None
        assert parent.sha256 == checkpoint.digest(finished / "model_1.pt")
        assert (parent.iteration, parent.harness) == (1, 1.0)
        assert "It started from HumoSlope-Stage1-Unitree-G1" in read_provenance(run / f"model_{number}.pt").training


def test_an_actor_of_another_width_is_refused_with_the_option_that_helps(task, tiny, finished, tmp_path, capsys):
    options = [*tiny, "--agent.hidden-dims", "32", "16", "--init", str(finished)]
    assert main(["train", task, "--run-dir", str(tmp_path / "run"), *options]) == 2
    assert "add --agent.hidden-dims 16 16" in capsys.readouterr().err
