"""A simulated PX4-like quadcopter autopilot that any MAVLink client can fly."""
