"""Reading to the end: the first fault is raised, or all of them are kept."""

import pytest

from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of, collected_faults, each, unless_at_fault


def half(number):
    if number % 2:
        raise UserError(number, expected="an even number", found="an odd one")
    return number // 2


def subjects(faults):
    return [fault.subject for fault in faults]


def test_elsewhere_the_first_fault_ends_the_reading():
    tried = []

    def read(number):
        tried.append(number)
        return half(number)

    for reading in (
        lambda: each(read, [0, 1, 2, 3]),
        lambda: all_of(lambda: read(0), lambda: read(1), lambda: read(3)),
    ):
        tried.clear()
        with pytest.raises(UserError, match="1: expected an even number, found an odd one"):
            reading()
        assert tried == [0, 1]
    with pytest.raises(UserError):
        unless_at_fault(lambda: half(1), otherwise=7)


def test_each_goes_on_without_the_items_at_fault():
    with collected_faults() as faults:
        assert each(half, [1, 2, 3, 4, 5]) == [1, 2]
        assert unless_at_fault(lambda: half(7), otherwise=0) == 0
        assert unless_at_fault(lambda: half(8), otherwise=0) == 4
    assert subjects(faults) == ["1", "3", "5", "7"]


def test_nothing_goes_on_where_every_item_is_at_fault():
    with collected_faults() as faults:
        each(half, [1, 3])
        pytest.fail("there is nothing to go on with")
    assert subjects(faults) == ["1", "3"]
    with collected_faults() as faults:
        assert each(half, []) == []
    assert faults == []


def test_all_of_tries_all_and_needs_all():
    with collected_faults() as faults:
        assert all_of(lambda: half(2), lambda: half(4)) == [1, 2]
        all_of(lambda: half(1), lambda: half(2), lambda: half(3))
        pytest.fail("a part is missing")
    assert subjects(faults) == ["1", "3"]


def test_readings_within_readings_are_in_order():
    def pair(number):
        return all_of(lambda: half(number), lambda: half(number + 2))

    with collected_faults() as faults:
        assert each(pair, [1, 2, 5]) == [[1, 2]]
    assert subjects(faults) == ["1", "3", "5", "7"]


def test_collecting_ends_with_its_context():
    with collected_faults():
        pass
    with pytest.raises(UserError):
        each(half, [1])
    with pytest.raises(ZeroDivisionError), collected_faults():
        each(lambda number: number / 0, [1])
