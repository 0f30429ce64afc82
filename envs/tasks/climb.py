"""Climbing (paper section B.4)."""

from functools import partial

from warpvox.envs.spec import Function, Observation, TaskSpec, observes, rewards, terminates
from warpvox.envs.terms.observations import ceiling, orientation, overhang, shape, velocity
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.terms.terminations import beyond
from warpvox.envs.worlds import columns

# As high as possible.
_climb = partial(
    TaskSpec,
    robot_cell=(1, 1),
    observations=(observes(velocity), observes(shape)),
    rewards=(rewards(displacement, axis="y"),),
)


def _sees(terrain: Function) -> tuple[Observation, ...]:
    above = observes(terrain, reach=3, objects=("pipe",))
    return (observes(velocity), observes(orientation), observes(shape), above)


TASKS = (
    _climb(
        *("Climber-v0", "B.4.1", "Climb as high as possible through a flat, vertical channel.", "medium"),
        objects=(columns("pipe", "90F", *5 * ["F 88. F"], "90F"),),  # a shaft 5 wide, closed at both ends
        max_episode_steps=400,
        terminations=(terminates(beyond, axis="y", limit=8.6, bonus=1.0),),
    ),
    _climb(
        *("Climber-v1", "B.4.2"),
        *("Climb as high as possible through a vertical channel of rigid and soft walls.", "medium"),
        objects=(
            columns(
                "pipe",
                "11F 2S 8F 2S 4F 2S 2F 2S 2F S 3F 3S 3F 2S 4F 3S 6F 5S 5F",
                *5 * ["F 68. F"],
                "8F S 6F 3S 5F 2S 3F 2S 5F 3S 7F 2S 4F 3S 2F 4S 10F",
            ),
        ),
        max_episode_steps=600,
        terminations=(terminates(beyond, axis="y", limit=6.5, bonus=1.0),),
    ),
    _climb(
        *("Climber-v2", "B.4.3", "Climb as high as possible through a narrow stepwise channel.", "hard"),
        objects=(
            columns(
                "pipe",
                *["24F", "F 22. 8F", "F 29. 5F", "F 33. 4F", "F 36. 2F", "F 37. 2F", "20F 19. 2F"],
                *["19. 9F 12. 2F", "27. 6F 8. F", "32. 2F 7. F", "33. 2F 6. F", "34. 2F 5. F"],
                *14 * ["35. F 5. F"],
                "35. 7F",
            ),
        ),
        max_episode_steps=1000,
        observations=_sees(ceiling),
        rewards=(rewards(displacement, axis="y"), rewards(displacement, weight=0.2, axis="x")),
        paper={"observations": _sees(overhang)},
    ),
)
