"""MAVLink on the wire: frames, signing, channels over UDP and TCP, routing between them, byte budgets."""
