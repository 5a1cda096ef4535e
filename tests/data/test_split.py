import pytest

from samira_warp.data.split import divide_timesteps, parse_split
from samira_warp.support.errors import UserError


@pytest.mark.parametrize(
    ("text", "kind", "value", "part"),
    [
        ("dataset", "dataset", 0, "test"),
        ("test", "dataset", 0, "test"),
        ("train", "dataset", 0, "train"),
        ("0.7", "fraction", 0.7, "test"),
        (".25", "fraction", 0.25, "test"),
        ("last:350", "last", 350, "test"),
    ],
)
def test_grammar(text, kind, value, part):
    split = parse_split(text)
    assert (split.text, split.kind, split.value, split.part) == (text, kind, value, part)


WRONG = ["", "0", "1", "1.0", "-0.5", "1.5", "nan", "inf", "val", "Train", "70%"]
WRONG += ["last", "last:", "last:0", "last:-3", "last:2.5", "last:x"]


@pytest.mark.parametrize("text", WRONG)
def test_anything_else_is_refused_with_the_grammar(text):
    with pytest.raises(UserError, match="last:N") as caught:
        parse_split(text)
    assert repr(text) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "count", "train_count"),
    [("0.5", 10, 5), ("0.7", 10, 7), ("0.7", 6, 4), ("0.98", 50, 49), ("last:1", 6, 5), ("last:5", 6, 1)],
)
def test_the_first_share_trains(text, count, train_count):
    train, test = divide_timesteps(parse_split(text), range(count))
    assert train == set(range(train_count))
    assert test == set(range(train_count, count))


def test_timesteps_are_divided_in_their_own_order_and_whole():
    views = [30, 10, 20, 10, 30, 20, 40, 40]
    assert divide_timesteps(parse_split("last:1"), views) == ({10, 20, 30}, {40})
    assert divide_timesteps(parse_split("0.5"), views) == ({10, 20}, {30, 40})


@pytest.mark.parametrize(
    ("text", "count"), [("0.01", 6), ("0.99", 6), ("last:6", 6), ("last:7", 6), ("0.5", 1), ("last:1", 1)]
)
def test_a_split_that_leaves_a_part_empty_is_refused(text, count):
    with pytest.raises(UserError, match="empty part") as caught:
        divide_timesteps(parse_split(text), range(count))
    assert text in str(caught.value)
