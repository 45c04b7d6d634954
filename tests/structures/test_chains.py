import numpy as np
import pytest
import scipy.linalg

from structures import chains
from structures.errors import InputError

from .exact import frequencies, solve


def test_oscillator():
    s = chains.oscillator(mass=2.0, stiffness=50.0, dashpot=0.3)
    assert [str(d) for d in s.dofs] == ["0+X", "1+X"]
    assert [str(d) for d in s.supports] == ["0+X"]
    assert frequencies(s, 1) == pytest.approx([5.0])
    assert s.C_free.toarray() == pytest.approx(np.array([[0.3]]))


@pytest.mark.parametrize("n", [1, 2, 7, 300])
def test_uniform_chains_have_the_closed_form(n):
    k, m = 3.0, 0.5
    r = np.arange(1, min(n, 10) + 1)
    fixed = chains.chain(masses=np.full(n, m), springs=k, right="fixed")
    assert frequencies(fixed, len(r)) == pytest.approx(2 * np.sqrt(k / m) * np.sin(r * np.pi / (2 * (n + 1))))
    tower = chains.shear_building(masses=np.full(n, m), stiffnesses=k)
    assert frequencies(tower, len(r)) == pytest.approx(
        2 * np.sqrt(k / m) * np.sin((2 * r - 1) * np.pi / (2 * (2 * n + 1)))
    )
    if n > 1:
        free = chains.chain(masses=np.full(n, m), springs=k, left="free")
        r = r[r < n]
        assert frequencies(free, len(r)) == pytest.approx(2 * np.sqrt(k / m) * np.sin(r * np.pi / (2 * n)))


def test_springs_in_series():
    k = np.array([1.0, 2.0, 4.0])
    s = chains.chain(masses=np.ones(3), springs=k)
    f = np.zeros(s.n)
    f[s.index("3+X")] = 1.0
    assert solve(s, f)[1:] == pytest.approx(np.cumsum(1 / k))


def test_dashpots_sit_beside_the_springs():
    s = chains.chain(masses=[1.0, 2.0], springs=[10.0, 20.0], dashpots=[0.1, 0.2])
    assert s.C.toarray() == pytest.approx(0.01 * s.K.toarray())
    assert scipy.linalg.eigvalsh(s.C_free.toarray()).min() > 0


def test_nodes_follow_the_masses():
    s = chains.chain(masses=[1.0, 2.0], springs=[1.0], left="free", direction="Z")
    assert [str(d) for d in s.dofs] == ["1+Z", "2+Z"]
    assert not s.supports
    assert s.M.diagonal() == pytest.approx([1.0, 2.0])


@pytest.mark.parametrize(
    "settings",
    [{"masses": [1.0, 0.0]}, {"masses": [1.0, -1.0]}, {"masses": [np.nan, 1.0]}, {"masses": []}, {"springs": [1.0]},
     {"springs": [1.0, 0.0]}, {"dashpots": [-1.0, 0.0]}, {"left": "pinned"}, {"direction": "Q"}, {"masses": [[1.0]]}],
)  # fmt: skip
def test_bad_chains_raise(settings):
    with pytest.raises(InputError):
        chains.chain(**{"masses": [1.0, 2.0], "springs": [1.0, 2.0], **settings})
