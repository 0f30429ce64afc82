"""One iteration of PPO on a device: a rollout, returns, all minibatches, moments of the observations."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import torch

from warpvox.algos.ppo.population import PopulationPPO
from warpvox.envs.adapters.rsl_rl import EPISODE_SUMS, RslRlVecEnv
from warpvox.envs.graph import Capture, Graph
from warpvox.errors import ActionError


class Iteration:
    """Runs iterations of PPO, which a CUDA graph replays if the environments can be captured.

    Without ``capture`` every iteration runs operation by operation. With it the first two do; then one is captured and
    replayed from then on: the host launches one graph and waits for nothing in it. All state between iterations is in
    tensors that keep their memory: those of the environments, the adapter, the storage, the networks and the optimiser.

    Args:
        env: environments of all designs of the algorithm.
        capture: records the launches of Warp; None: nothing is captured.

    Attributes:
        ended: bool ``[num_envs]``, environments in which an episode has ended in the last iteration.
        whole, returns: ``[steps, num_envs]``, the entries of ``extras`` with these names in each step of it.
    """

    def __init__(self, env: RslRlVecEnv, algorithm: PopulationPPO, capture: Capture | None = None) -> None:
        self.env = env
        self.algorithm = algorithm
        self._graph = None
        if capture is not None:
            self._graph = Graph(capture, "Iterations of PPO", algorithm.streams.generators)
        self._names: list[str] = []
        self._marks: list[torch.cuda.Event] = []
        if algorithm.rates.device.type == "cuda":
            with suppress(TypeError):  # torch 2.7 and 2.8 have no such events
                # external: within a graph they are recorded again by each replay
                self._marks = [torch.cuda.Event(enable_timing=True, external=True) for _ in range(3)]

    def __call__(self) -> None:
        """Run one iteration; its figures are read by :meth:`read`."""
        self.algorithm.prepare()
        if self._graph is None:
            results = self._on_device()
        else:
            results = self._graph(self._on_device)
            self.env.env.sim.forget_sensed()
        self._figures, self.ended, self.whole, self.returns = results

    @property
    def is_replayed(self) -> bool:
        """True once an iteration is nothing but the replay of a graph, during which the host is idle."""
        return self._graph is not None and self._graph.is_recorded

    def read(self) -> dict[str, float]:
        """Return figures of the last iteration, as means over the designs; waits for the device once.

        They are the losses ``value``, ``surrogate`` and ``entropy``, ``learning_rate``, ``action_std``, ``finite`` (0:
        networks or moments have numbers that are not), ``not_finite_total`` of the environments,
        :data:`EPISODE_SUMS`, and the means of what steps log (``extras["log"]``).
        """
        return dict(zip(self._names, self._figures.tolist(), strict=True))

    def seconds(self) -> tuple[float, float]:
        """Return the seconds that a GPU took for the rollout and for learning in the last iteration.

        0 where that is not known: on the CPU, and with a torch that cannot measure it.
        """
        if not self._marks:
            return 0.0, 0.0
        began, collected, learned = self._marks
        return began.elapsed_time(collected) / 1000, collected.elapsed_time(learned) / 1000

    def _on_device(self) -> tuple[torch.Tensor, ...]:
        """Run the part of an iteration that a CUDA graph records; return its figures and what episodes ended."""
        algorithm = self.algorithm
        algorithm.storage.clear()  # a capture may have failed on its way
        self._mark(0)
        steps = self._collect()
        self._mark(1)
        losses = algorithm.update()
        self._mark(2)

        # Figures
        policy = algorithm.actor.distribution
        deviations = policy.log_std_param.detach().clamp(*policy.limits).exp() * policy.mask
        finite = algorithm.healthy().all()
        for moments in algorithm.actor.obs_normalizer.buffers():
            finite = finite & torch.isfinite(moments).all()
        figures = {name: loss.mean() for name, loss in losses.items()}
        figures["learning_rate"] = algorithm.rates.mean()
        figures["action_std"] = deviations.sum() / policy.mask.sum()
        figures["finite"] = finite
        figures["not_finite_total"] = self.env.env.not_finite_total()
        figures |= dict(zip(EPISODE_SUMS, self.env.take_sums(), strict=True))
        for name in steps[0]["log"]:
            figures[name] = torch.stack([step["log"][name] for step in steps]).double().mean()
        self._names = list(figures)
        vector = torch.stack([value.double() for value in figures.values()])

        ended = torch.stack([step["dones"] for step in steps]).any(0)
        whole = torch.stack([step["whole"] for step in steps])
        returns = torch.stack([step["returns"] for step in steps])
        return vector, ended, whole, returns

    def _mark(self, place: int) -> None:
        """Record the time on the device: 0: the iteration begins, 1: learning begins, 2: learning ends."""
        if self._marks:
            self._marks[place].record()

    @torch.no_grad()
    def _collect(self) -> list[dict[str, Any]]:
        """Fill the storage with a rollout; return dones, logs and returns of each step."""
        algorithm = self.algorithm
        env = self.env
        obs = env.get_observations()
        steps: list[dict[str, Any]] = []
        for _ in range(algorithm.storage.num_transitions_per_env):
            actions = algorithm.act(obs)
            try:
                obs, rewards, dones, extras = env.step(actions)
            except ActionError:
                # A design has diverged. The others go on; what its update learns from shows it to be unhealthy.
                obs, rewards, dones, extras = env.step(actions.nan_to_num(0.0, 0.0, 0.0))
            algorithm.process_env_step(obs, rewards, dones, extras)
            steps.append({"dones": dones, **{name: extras[name] for name in ("log", "whole", "returns")}})
        algorithm.compute_returns(obs)
        return steps
