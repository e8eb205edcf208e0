"""Options of a command line as words, without knowing what they mean."""

from __future__ import annotations


def merge_options(first: list[str], then: list[str], without: tuple[str, ...] = ()) -> list[str]:
    """Two lists of options as one, in which a later option replaces an earlier one of the same name.

    Args:
        without: Names to leave out.
    """
    groups = option_groups([*first, *then])
    return [word for name, words in groups.items() if name not in without for word in words]


def option_groups(options: list[str]) -> dict[str, list[str]]:
    """Words of each option by its name, written with dashes. Of several options with one name the last one counts."""
    groups: dict[str, list[str]] = {}
    name = ""
    for word in options:
        if word.startswith("--"):
            name = word.partition("=")[0].replace("_", "-")
            groups.pop(name, None)
        groups.setdefault(name, []).append(word)
    return groups
