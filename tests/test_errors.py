"""A user's mistake is said in one line that can be read."""

from __future__ import annotations

from humoslope.errors import UserError, unknown


def test_a_message_is_one_line_whatever_was_typed() -> None:
    assert str(UserError("task 'a\nb\u202e' does not exist.")) == r"task 'a\nb\u202e' does not exist."
    assert str(UserError("größer als 10 °, 'ü'.")) == "größer als 10 °, 'ü'."


def test_what_is_too_long_to_be_read_is_cut() -> None:
    said = str(unknown("body", 5000 * "x", ["pelvis"]))
    assert said == f"body '{60 * 'x'}...' does not exist; there are: pelvis."
    path = 299 * "p"
    assert str(UserError(f"'{path}' does not exist.")) == f"'{path}' does not exist."
