"""Streams are part of what a recorded flight means: a replay draws them again."""

from rf_model.seeding import generator_of, seed_of, vehicle_seeds


def test_streams_stay_those_of_flights_already_recorded():
    assert seed_of(7, 3) == 5061563556724077661
    assert generator_of(7, 3, 1).initial_seed() == 6665335680343557524
    assert vehicle_seeds(7, ["a", "b"]) == {"a": 7, "b": 4060404087698782352}


def test_a_generator_takes_any_seed():
    seeds = [seed_of(number) for number in range(100)]
    assert max(seeds) >= 2**63  # which a signed 64-bit number does not hold
    assert len({generator_of(number).initial_seed() for number in range(100)}) == 100
    assert all(generator_of(number).initial_seed() < 2**63 for number in range(100))
