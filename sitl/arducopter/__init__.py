"""The ArduCopter personality, as recorded from ArduCopter 4.7-dev's built-in quadrotor."""
