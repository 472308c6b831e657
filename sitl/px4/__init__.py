"""The PX4 personality, as recorded from PX4's SIH quadrotor."""
