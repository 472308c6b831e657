"""The vehicle in its world: rigid body, control law, wind, sensors and battery, and what of it is compiled."""
