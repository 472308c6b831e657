"""A simulated PX4 or ArduCopter quadcopter autopilot that any MAVLink client can fly."""
