"""Every hyper-parameter of training, in one validated place."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(gt=0, le=1)]
Probability = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]


class TrainingConfig(BaseModel):
    """DA-DDPG's learning switches and hyper-parameters. Where the paper gives a value it is the default.

    No value is converted, except whole numbers to floats.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    environments: Annotated[int, Field(ge=2)] = 32
    """Environments stepped side by side; all start and end their episodes together."""
    acceleration_mps2: Positive | None = None
    """Inertia of the vehicle (the bridge plans with 3); none: it moves as by teleport, as in the paper."""
    episodes: Count = 12_800
    """Episodes in all, over all environments."""
    updates_per_step: Count = 8
    """Gradient updates per step of all environments."""
    batch_size: Annotated[int, Field(ge=2)] = 64
    replay_capacity: Count = 100_000
    warmup: Annotated[int, Field(ge=0)] = 3200
    """Transitions of random actions before the first update."""

    hidden: Annotated[tuple[Count, ...], Field(min_length=1), Strict(False)] = (256, 256)
    """Widths of the dense layers of the actors and of the critic's state branch: the paper has 256 to 512 by N."""
    actor_lr: Positive = 1e-4
    critic_lr: Positive = 1e-3
    discount: Annotated[float, Field(ge=0, le=1)] = 0.9
    """zeta of paper eq. 24; the paper has 1, which is sound for episodes that end (`time_limit: terminates`)."""
    time_limit: Literal["truncates", "terminates"] = "truncates"
    """Whether values go on beyond an episode's last slot, or end there, which a state must tell by its time."""
    soft_update: Fraction = 0.005
    """tau: w' <- (1 - tau) w' + tau w (Alg. 1, whose printed line would change nothing)."""
    target_state: Literal["next", "current"] = "next"
    """State of the bootstrapped value in eq. 27; the paper prints the current one."""
    actor_update: Literal["replay_other", "joint"] = "replay_other"
    """Eq. 28: each actor is differentiated with the other half from replay, or both together."""
    discrete_gradient: Literal["straight_through", "tanh"] = "straight_through"
    """What the critic sees of the discrete actor while it learns: its signs, or its tanh output."""
    saturation_penalty: NonNegative = 1e-2
    """Weight of the mean squared pre-tanh output in the actors' loss: without it tanh saturates at once."""
    reward_scale: Positive = 1.0
    """The critic learns reward times this."""

    noise_theta: Fraction = 0.15
    noise_start: NonNegative = 0.2
    noise_end: NonNegative = 0.02
    """Standard deviation of the OU noise (eq. 29), first and last."""
    epsilon_start: Probability = 0.5
    epsilon_end: Probability = 0.02
    """Probability of a random sign (eq. 31), first and last."""
    decay_fraction: Fraction = 0.6
    """Noise and epsilon reach their last value after this part of the run."""

    clone_updates: Annotated[int, Field(ge=0)] = 2000
    """Offline: updates of behaviour cloning first."""
    offline_updates: Annotated[int, Field(ge=0)] = 4000
    """Offline: DA-DDPG updates after that."""
    cloning: NonNegative = 10.0
    """Offline: weight of the cloning loss in those, relative to |Q|; with 1 they stray farther from what was flown than
    its mean action does."""

    evaluate_every: Count = 128
    """Episodes between evaluations; they cost little, and the policy swings from one to the next."""
    evaluation_episodes: Annotated[int, Field(ge=2)] = 256
    evaluation_seed: Annotated[int, Field(ge=0, lt=2**63)] = 1_000_003
    """The same worlds at every evaluation, never those of training."""
    save_every: Count = 1280
    """Episodes between saves of the state that `--resume` takes up."""

    @model_validator(mode="after")
    def _sizes_fit(self) -> "TrainingConfig":
        if self.replay_capacity < max(self.environments, self.warmup):
            raise ValueError(
                f"replay_capacity: {self.replay_capacity} is less than environments ({self.environments}) "
                f"or warmup ({self.warmup})"
            )
        return self
