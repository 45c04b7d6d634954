"""Every ordinary mistake of `tests.campaigns.mistakes` leads where it says, through the real command line."""

import pytest

from tests.campaigns import mistakes


@pytest.fixture(scope="module")
def at(tmp_path_factory):
    return mistakes.made(tmp_path_factory.mktemp("mistakes"))


def test_each_of_them_has_its_name_and_its_words():
    assert len({one.name for one in mistakes.MISTAKES}) == len(mistakes.MISTAKES) >= 94
    assert all(one.says or 0 in one.codes for one in mistakes.MISTAKES)


@pytest.mark.parametrize("one", mistakes.MISTAKES, ids=lambda one: one.name)
def test_a_mistake_leads_where_it_should(at, one):
    try:
        found = mistakes.judged(one, at)
    except ModuleNotFoundError as error:
        pytest.skip(f"{error.name} is not installed")
    assert found.judged == "right", f"{found.judged}: exit {found.code}: {found.said}"


def test_the_judge_sees_what_is_wrong(at):
    """A wrong number, an answer where there must be none, a hint that misleads, or that is none."""
    right = mistakes.Mistake("right", lambda a: a.identify(), (0,))
    assert mistakes.judged(right, at).judged == "right"
    assert mistakes.judged(mistakes.Mistake("other", right.argv, (3,)), at).judged == "wrong answer"
    every = mistakes.table(*mistakes.LAST)
    every[:, 2:] *= 3
    assert mistakes.judged(mistakes.Mistake("3", lambda a: a.identify(a.csv("x.csv", every)), (0,)), at).judged == (
        "wrong answer"
    )

    def missing(**right):
        one = mistakes.Mistake("missing", lambda a: a.identify(a.path / "none.csv"), **right)
        return mistakes.judged(one, at).judged

    assert missing(never=("no such file",)) == "misleading hint"
    assert missing(says=("xyzzy",)) == "not said: xyzzy"
    assert missing(codes=(2,)) == "exit code 3"
    assert missing(says=("none.csv",)) == "right"
