"""Environment, dual-actor DDPG, policies and the agent node."""

import gymnasium

gymnasium.register(
    "AerialStar-v0",
    entry_point="agent.gym_env:AerialStarEnv",
    vector_entry_point="agent.vector_env:AerialStarVectorEnv",
)
