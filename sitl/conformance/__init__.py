"""Conformance kit: flies any MAVLink quadrotor autopilot and says what of the protocol it keeps.

It is a client like any other: it knows nothing of the simulator beside it, and judges by where the vehicle is.
"""
