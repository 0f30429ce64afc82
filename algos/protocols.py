"""Protocols of evaluation: disturbances and numbers of episodes."""

from dataclasses import dataclass

from warpvox.errors import ConfigError


@dataclass(frozen=True)
class Disturbance:
    """Disturbance of an episode's actions, start or observations.

    Attributes:
        noise: deviation of normal noise on each action, in units of target length (actions are 0.6 to 1.6).
        sticky: probability that the actions of the control step before are repeated, all of them (Machado et al.
            2018, section 5.2).
        start: most control steps with uniform actions at the beginning, at least 1 of them; rewards count.
        sensors: deviation of normal noise on each observation but the types and neighbours of cells.
    """

    noise: float = 0.0
    sticky: float = 0.0
    start: int = 0
    sensors: float = 0.0


NOMINAL = "nominal"
DISTURBANCES = {
    NOMINAL: Disturbance(),
    "noise": Disturbance(noise=0.01),
    "sticky": Disturbance(sticky=0.25),
    "start": Disturbance(start=10),
    "sensors": Disturbance(sensors=0.01),
}
PROTOCOLS = {name: (name,) for name in DISTURBANCES} | {"robust": tuple(DISTURBANCES)}
"""Disturbances of each evaluation protocol, by name."""
CHOOSING = (NOMINAL, "noise")
"""Protocols by which trainings and searches choose the best: one undisturbed episode, or several with action noise."""
COPIES = 8
"""Default number of disturbed episodes per policy."""


def parts_of(protocol: str, feedback: bool) -> tuple[str, ...]:
    """List the disturbances of a protocol that apply to a policy; ConfigError: none does."""
    found = tuple(name for name in PROTOCOLS[protocol] if feedback or name != "sensors")
    if not found:
        raise ConfigError("protocol=sensors needs a policy with feedback; an open-loop one acts by the time alone.")
    return found


def episodes_of(given: int | None, protocol: str) -> int:
    """Return the number of evaluation episodes: ``given``, or the default of ``protocol``."""
    return given or (COPIES if protocol != NOMINAL else 1)
