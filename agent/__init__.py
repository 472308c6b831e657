"""Environment, dual-actor DDPG, policies and the agent node."""

import gymnasium

gymnasium.register("AerialStar-v0", entry_point="agent.gym_env:AerialStarEnv")
