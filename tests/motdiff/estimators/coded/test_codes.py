"""Codes from which no order in time can be told are refused in one line."""

import re

import pytest

from motdiff.estimators.coded.codes import check_codes


@pytest.mark.parametrize(
    ("codes", "message"),
    [
        (["1011", "10a1"], "code 2: needs bits"),
        (["", "1011"], "code 1: needs bits"),
        (["1011", "0000"], "code 2: needs bits with at least one open chip"),
        (["1011", "10110"], "code 2: has 5 chips, the first one 4"),
        (["1111", "1111"], "code: order cannot be known"),
        (["1"], "code: order cannot be known"),
        ([], "code: "),
    ],
)
def test_refusals(codes: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}") as refusal:
        check_codes(codes)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("codes", [["1" * 52, "1" * 26 + "0" * 26], ["10"], ["10", "10"]])
def test_codes_that_show_time_are_taken(codes: list[str]) -> None:
    check_codes(codes)
