"""The zenoh contract: message schemas, topics and how a session is opened."""
