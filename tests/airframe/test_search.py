import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from airframe.search import largest_share, root


@given(st.floats(0.1, 5), st.floats(0.5, 4), st.floats(0.01, 50))
def test_a_root_is_where_another_method_finds_it(scale, power, level):
    def rising(x):
        return scale * x**power - level

    high = (level / scale) ** (1 / power) * 3
    assert root(rising, 0.0, high) == pytest.approx(brentq(rising, 0.0, high, xtol=1e-13), rel=1e-9, abs=1e-9)


def test_a_root_at_the_lower_end_is_found_at_once():
    assert root(lambda x: x, 0.0, 1.0) == 0.0


shapes = st.sampled_from(
    [
        lambda x: x,
        lambda x: x * x,
        math.sqrt,
        lambda x: math.expm1(5 * x),
        lambda x: 1.0 + x,  # a step, as where another thing gets in the way
    ]
)


@given(shapes, st.floats(0.0, 0.999), st.sampled_from([1e-2, 1e-4]), st.booleans())
def test_the_largest_share_without_excess_whatever_is_said_below_it(shape, last_good, tolerance, flat):
    def excess(share):
        if share > last_good:
            return shape(share - last_good) + 1e-9
        return 0.0 if flat else share - last_good

    share = largest_share(excess, excess(1.0), tolerance)
    assert share <= last_good
    assert share == pytest.approx(last_good, abs=max(tolerance, 2**-12))


def test_it_takes_few_trials_where_the_excess_is_smooth():
    trials = []

    def excess(share):
        trials.append(share)
        return 3.0 * (share - 0.37) + (share - 0.37) ** 2

    assert largest_share(excess, excess(1.0), 1e-3) == pytest.approx(0.37, abs=1e-3)
    assert len(trials) <= 7
