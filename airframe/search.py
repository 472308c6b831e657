"""Where a function of one number crosses zero."""

from collections.abc import Callable

ROUNDS = 60
"""Most steps of a root search; some eight are needed."""
TRIALS = 24
"""Most steps of a share's; some seven are needed."""


def root(rising: Callable[[float], float], low: float, high: float) -> float:
    """A root between `low`, where the function is below zero, and `high`, where it is not (regula falsi, Illinois).

    The first guess is where a slope of 1 leads.
    """
    at_low = rising(low)
    if at_low >= 0.0:
        return low
    guess = min(low - at_low, high)
    at_guess = rising(guess)
    if at_guess < 0.0:
        low, at_low, at_high = guess, at_guess, rising(high)
    else:
        high, at_high = guess, at_guess
    side = 0
    for _ in range(ROUNDS):
        if high - low < 1e-12:
            break
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        value = rising(middle)
        if abs(value) < 1e-12:
            return middle
        if value < 0.0:
            low, at_low = middle, value
            at_high = at_high / 2 if side == -1 else at_high
            side = -1
        else:
            high, at_high = middle, value
            at_low = at_low / 2 if side == 1 else at_low
            side = 1
    return high


def largest_share(excess: Callable[[float], float], at_one: float, tolerance: float) -> float:
    """A share of a way, 0 to 1, at which there is no `excess` (none above 0), but is one `tolerance` further on.

    0 is taken to have none, 1 has `at_one`. By bisection, or better where two shares that have it tell how soon there
    will be none any more. What the function says where there is no excess plays no part.
    """
    good, bad, bad_excess = 0.0, 1.0, at_one
    guess, told = 0.5, 0
    for _ in range(TRIALS):
        if bad - good <= tolerance:
            break
        found = excess(guess)
        if found <= 0.0:
            good, told = guess, 0
        else:
            soon = guess - (bad - guess) * found / (bad_excess - found) if bad_excess > found else good
            told = (told + 1) % 4 if soon > good else 0  # from time to time halve, where that comes near too slowly
            bad, bad_excess = guess, found
        guess = max(soon - tolerance / 2, good + (bad - good) / 8) if told else (good + bad) / 2
    return good
