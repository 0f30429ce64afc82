"""Training loop: PPO with evaluations, metrics, atomic checkpoints and exact resumption."""

import contextlib
import math
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")  # GitPython, which rsl-rl imports, demands the program otherwise
from rsl_rl.runners import OnPolicyRunner
from rsl_rl.utils.logger import Logger

from warpvox.algos.checkpoints.files import (
    RNN,
    check_fits,
    damaged,
    load_checkpoint,
    save_checkpoint,
    spec_dict,
    spec_for,
    spec_of,
)
from warpvox.algos.checkpoints.policy import Policy
from warpvox.algos.evaluate import EpisodeReturns, Evaluator
from warpvox.algos.expected import check_like
from warpvox.algos.generators import Generators
from warpvox.algos.interrupt import deferred_interrupts
from warpvox.algos.metrics import Metrics, read_metrics
from warpvox.algos.ppo.fused import FusedPPO
from warpvox.algos.ppo.iteration import Iteration
from warpvox.algos.ppo.stock import PPO, rsl_rl_config
from warpvox.algos.settings import WIDEST, Ppo
from warpvox.algos.training.bodies import Bodies
from warpvox.algos.training.distributed import SINGLE_PROCESS, ProcessGroup
from warpvox.devices.startup import own_torch
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.errors import ActionError, ConfigError, DivergenceError, RunError
from warpvox.io.writing import check_folder
from warpvox.runs import BEST, STATE, Run

COUNTERS = {
    "elapsed": float, "best_return": float, "best_iteration": int, "processes": int, "env": dict, "random": dict,
    "memory": dict,
}  # fmt: skip
"""Entries of a training state besides networks and optimiser, with their types."""

HOST_BOUND = 0.1
"""Fraction of time waiting for the GPU below which training counts as host-bound."""


@dataclass(frozen=True)
class _Evaluation:
    """An evaluation running in a thread while learning continues.

    ``result``: its outcome, once it has ended. ``policy``: checkpoint content of the policy under evaluation.
    ``state``: of the runner at that time, to return to if the evaluation reaches ``stop_return``; None: there is no
    such goal.
    """

    result: Future[EpisodeReturns]
    policy: dict[str, Any]
    state: dict[str, Any] | None


@dataclass(frozen=True)
class Schedule:
    """Iterations at which training saves, evaluates and stops.

    ``total``: iterations of the whole run; ``save``, ``evaluate``: intervals; ``stop_return``: an evaluation
    that reaches it ends the run.
    """

    total: int
    save: int = 50
    evaluate: int = 10
    stop_return: float | None = None


def adapt(env: Any, ppo: Ppo, apart: bool = False) -> RslRlVecEnv:
    """Wrap a :class:`VoxelVecEnv` for rsl-rl with the settings ``ppo``; ``apart``: no moments shared by designs."""
    if env.num_obs > WIDEST:  # of a checkpoint more are not read
        raise ConfigError(f"A policy takes {WIDEST:,} observations at most; this task and body have {env.num_obs:,}.")
    own = {name: getattr(ppo, name) for name in ("action_scale", "reward_scale", "bootstrap_time_limit")}
    return RslRlVecEnv(env, reward_gamma=ppo.gamma if ppo.normalize_reward else None, apart=apart, **own)


@dataclass
class TimeSpent:
    """Seconds spent on simulation and learning, without evaluations.

    ``simulation``: rollouts, the policy's forward passes included; ``learning``: updates. ``launching`` and
    ``waiting``: of the host, giving work to a GPU and waiting until it is done; 0 on a CPU.
    """

    simulation: float = 0.0
    learning: float = 0.0
    launching: float = 0.0
    waiting: float = 0.0

    @property
    def shares(self) -> dict[str, float]:
        """Fractions of time spent on simulation and on learning (sum 1); empty at first."""
        whole = self.simulation + self.learning
        return {"simulation": self.simulation / whole, "learning": self.learning / whole} if whole else {}

    @property
    def is_host_bound(self) -> bool:
        """True if the GPU mostly waits for the host to launch work."""
        return self.launching > 0 and self.waiting < HOST_BOUND * (self.launching + self.waiting)

    def __str__(self) -> str:
        """Format the shares in percent, with a note if training is host-bound."""
        parts = [", ".join(f"{name} {100 * share:.0f} %" for name, share in self.shares.items())]
        if self.is_host_bound:
            parts.append("host-bound: more environments cost nothing")
        return "; ".join(part for part in parts if part)


class _Rollout(Logger):
    """Replacement of rsl-rl's logger that collects the figures of one iteration.

    ``ended``: bool ``[num_envs]``, environments in which an episode has ended. ``steps``: control steps of a rollout.
    """

    writer = None

    def __init__(self, bodies: Bodies | None, steps: int, spent: TimeSpent) -> None:
        self.bodies = bodies
        self.steps = steps
        self.spent = spent

    def init_logging_writer(self) -> None:
        """Start the record of an iteration."""
        self._began = time.perf_counter()
        self._logs: list[dict[str, torch.Tensor]] = []
        self.ended = torch.tensor(False)

    def process_env_step(
        self, rewards: torch.Tensor, dones: torch.Tensor, extras: dict, intrinsic_rewards: object = None
    ) -> None:
        """Record the logs and ended episodes of one control step; after the last on CUDA, time the wait."""
        self._logs.append(extras["log"])
        self.ended = dones | self.ended
        if self.bodies is not None:
            self.bodies.record(extras["whole"], extras["returns"])
        if len(self._logs) == self.steps and dones.device.type == "cuda":
            # Learning waits for the device a hundred times; one time more says how long the rollout has taken.
            launched = time.perf_counter()
            torch.cuda.synchronize(dones.device)
            self.spent.launching += launched - self._began
            self.spent.waiting += time.perf_counter() - launched

    def log(self, *, loss_dict: dict[str, float], collect_time: float, learn_time: float, **_: object) -> None:
        """Record losses and times of the update, and average the logs over the control steps."""
        self.losses = loss_dict
        self.spent.simulation += collect_time
        self.spent.learning += learn_time
        # copied from the device at once
        steps = torch.stack([torch.stack([value.double() for value in log.values()]) for log in self._logs])
        self.means = dict(zip(self._logs[0], steps.mean(0).tolist(), strict=True))
        self.means |= {f"Loss/{name}": loss for name, loss in loss_dict.items() if name in ("rnd", "symmetry")}


class Runner(OnPolicyRunner):
    """rsl-rl's runner with evaluations, a table of metrics, atomic checkpoints and exact resumption.

    ``current_learning_iteration`` counts complete iterations. With ``folder`` the run leaves there
    ``model_<iteration>.pt``, ``model_best.pt`` (best evaluation), ``state.pt`` (for :meth:`resume`),
    ``metrics.csv`` and TensorBoard events; without, nothing. ``saved_iteration`` is that of the newest ``state.pt``.
    ``report`` is called after every iteration with its row of ``metrics.csv``; ``spent`` says where time has gone.

    Args:
        env: see :func:`adapt`.
        folder: of the run; must exist.
        evaluator: says how good the policy is without exploration; None: no evaluations.
        logger: where metrics go besides ``metrics.csv``, :data:`warpvox.algos.settings.LOGGERS`.
        group: the processes that train this policy together, each with its own ``env``. The first evaluates, writes
            and reports; its ``evaluator`` and ``report`` are the only ones that are used.
        voxels: of a policy for voxels, see :func:`warpvox.algos.ppo.stock.rsl_rl_config`.
        bodies: which bodies take the place of others; None: all stay.
        generators: random numbers for the networks, the actions and the order of learning; None: those that torch's own
            generators would give.
        torch_threads: threads of torch; None: as many as the caller has.
    """

    alg: PPO
    env: RslRlVecEnv

    def __init__(
        self,
        env: RslRlVecEnv,
        ppo: Ppo,
        schedule: Schedule,
        folder: Path | None = None,
        evaluator: Evaluator | None = None,
        group: ProcessGroup = SINGLE_PROCESS,
        voxels: Mapping[str, Any] | None = None,
        logger: str = "tensorboard",
        bodies: Bodies | None = None,
        trained_on: Mapping[str, Any] | None = None,
        generators: Generators | None = None,
        torch_threads: int | None = None,
    ) -> None:
        ppo.check(env.num_envs)
        self.ppo = ppo
        self.schedule = schedule
        self.folder = folder
        self.evaluator = evaluator
        self.group = group
        self.report: Callable[[Mapping[str, float]], None] | None = None
        self.bodies = bodies
        self.trained_on = dict(trained_on or {})
        self.env = env
        self.device = str(env.device)
        self.generators = generators or Generators(None, self.device)
        self.torch_threads = torch_threads

        # The algorithm. rsl-rl's own way to it prints both networks, and draws from torch's generator.
        self.cfg = rsl_rl_config(ppo, schedule.total, voxels)
        self._configure_multi_gpu()
        try:
            self.alg = PPO.of(env, self.cfg, self.generators, self.cfg["multi_gpu"])
        except (TypeError, ValueError, LookupError, AttributeError) as error:
            if not (ppo.rnn or ppo.extra):
                raise
            raise ConfigError(f"ppo.rnn or ppo.extra is not what rsl-rl takes: {error}") from error
        self.spec = spec_for(
            ppo,
            env.get_observations()["policy"].shape[1],
            env.num_actions,
            voxels=None if voxels is None else dict(voxels),
            rnn=None if ppo.rnn is None else RNN | ppo.rnn,
        )

        # Progress
        self.spent = TimeSpent()
        self.logger = _Rollout(bodies, ppo.steps, self.spent)
        self._writer = logger
        self._metrics: Metrics | None = None
        self._judged: EpisodeReturns | None = None
        self.current_learning_iteration = 0
        self.saved_iteration = None
        self.elapsed = 0.0
        self.best_return = -math.inf
        self.best_iteration = 0
        self.last_return = math.nan
        self._kept = -math.inf  # return of the policy in model_best.pt, which may be newer than the state
        self._turned_back = False  # whether training continues from a checkpoint that may be older than state.pt

        # On CUDA this learns instead of `alg`, which is only brought up to date when it is needed
        self._iteration: Iteration | None = None
        self._is_behind = False

        # Rows that are not reported yet, each with further means for loggers; the evaluation that the first waits for
        self._rows: list[tuple[dict[str, float], dict[str, float]]] = []
        self._evaluation: _Evaluation | None = None

    def _configure_multi_gpu(self) -> None:
        """Set ranks as rsl-rl does, for processes that are already connected."""
        group = self.group
        self.is_distributed = False
        self.gpu_world_size = group.size
        self.gpu_global_rank = group.rank
        ranks = {"global_rank": group.rank, "local_rank": group.local_rank, "world_size": group.size}
        self.cfg["multi_gpu"] = ranks if group.size > 1 else None

    @property
    def steps_per_iteration(self) -> int:
        return self.ppo.steps * self.env.num_envs * self.group.size

    @property
    def steps(self) -> int:
        """Control steps of all environments so far."""
        return self.current_learning_iteration * self.steps_per_iteration

    @property
    def policy(self) -> Policy:
        """Present policy without exploration, on the CPU."""
        self._catch_up()
        return Policy(self.spec, self.alg.get_policy().state_dict())

    def run(self) -> None:
        """Train until the schedule ends or ``stop_return`` is reached.

        The first interrupt waits for the end of the iteration, saves, and then raises KeyboardInterrupt.

        Raises:
            DivergenceError: learning has diverged.
            StorageError: the folder cannot be written any more; what was saved last is whole, and learning goes on from
                there as if nothing had happened.
        """
        left = self.schedule.total - self.current_learning_iteration
        if left > 0:
            self.learn(left, init_at_random_ep_len=self.ppo.random_start)

    def learn(self, num_learning_iterations: int, init_at_random_ep_len: bool = False) -> None:
        """Train for ``num_learning_iterations``; only the very first may start at random episode lengths."""
        end = self.current_learning_iteration + num_learning_iterations
        self._rows.clear()
        self._evaluation = None
        self._is_default_type_ours = torch.get_default_dtype() == self.env.network_dtype
        with self._own_torch():
            self._begin(init_at_random_ep_len)
            threads = torch.get_num_threads()
        try:
            # torch's number of threads is a setting of every thread
            with (
                ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(threads,)) as self._thread,
                deferred_interrupts() as interrupt,
            ):
                while self.current_learning_iteration < end and not self._reached_goal():
                    # Run one iteration; if it diverges, report the rows before it.
                    try:
                        with self._own_torch():
                            row = self._iterate(end)
                    except DivergenceError:
                        self._await_evaluation()
                        self._report()
                        if not self._reached_goal():
                            raise
                        continue
                    self._rows.append((row, self.logger.means))

                    # Report, unless a thread still evaluates and may go on with that
                    done = self.current_learning_iteration
                    is_saved = done % self.schedule.save == 0 and done != end
                    is_wanted = is_saved or done == end or self._is_due(done + 1, end)
                    if self._evaluation is None or is_wanted or self._evaluation.result.done():
                        self._await_evaluation()
                        self._report()

                    # Save as scheduled, or because somebody has asked to stop
                    is_stopped = self.group.any(bool(interrupt))
                    if is_saved or is_stopped:
                        self._await_evaluation()
                        self._report()
                        self.save_all()
                    if is_stopped:
                        interrupt.raise_interrupt()
            self._catch_up()
            self.save_all()
        finally:
            if self._metrics is not None:
                self._metrics.close()

    def _report(self) -> None:
        """Write pending metrics rows, pass them to ``report``, and clear them."""
        while self._rows:
            row, means = self._rows.pop(0)
            self.logger.means = means  # trackers read them
            if self._metrics is not None:
                self._metrics.write(row, means)
            if self.report is not None and self.group.is_main_process:
                self.report(row)

    def _is_due(self, iteration: int, end: int) -> bool:
        """Return whether ``iteration`` has an evaluation: at each interval, and at the ``end``."""
        return iteration % self.schedule.evaluate == 0 or iteration == end

    def _reached_goal(self) -> bool:
        """Return whether the last evaluation reached ``stop_return``."""
        goal = self.schedule.stop_return
        return goal is not None and self.last_return >= goal

    def _own_torch(self) -> contextlib.AbstractContextManager[None]:
        """Return a context for one iteration with its own torch settings and global seed.

        Code of the user's may draw from torch's global generators: the same numbers again if the run is resumed.
        """
        seed = (self.generators.seed + self.current_learning_iteration) % 2**63
        return own_torch(self.torch_threads, seed, self.env.network_dtype)

    def _begin(self, init_at_random_ep_len: bool) -> None:
        """Prepare for :meth:`learn`: first state file, episode lengths, metrics, networks of other processes."""
        # A run can be resumed whenever it is killed.
        if self.current_learning_iteration == 0 or self._turned_back:
            self.save_state()

        # Episodes begin at random times, so that they do not all end at once.
        if init_at_random_ep_len and self.current_learning_iteration == 0:
            longest = int(self.env.max_episode_length)
            lengths = torch.randint(longest, (self.env.num_envs,), generator=self.generators.on("cpu"))
            self.env.episode_length_buf = lengths.to(self.env.device)

        # Remove later checkpoints: their iterations will be repeated.
        if self.folder is not None and self.group.is_main_process:
            for number in Run(self.folder, {}).iterations:
                if number > self.current_learning_iteration > 0:
                    (self.folder / f"model_{number}.pt").unlink()
            self._metrics = Metrics(self.folder, self.current_learning_iteration, self._writer)

        if self.group.size > 1:
            self.alg.broadcast_parameters()

        # On CUDA kernel launches take most of the time: if our own PPO can learn, an iteration becomes one graph.
        is_ours = self.spec.is_mlp and not self.ppo.extra and self.group.size == 1
        if self._iteration is None and is_ours and torch.device(self.device).type == "cuda":
            self._iteration = self._make_iteration()

    def _make_iteration(self) -> Iteration:
        """Create an iteration on the device from the networks and optimiser state of ``alg``."""
        settings = {name: value for name, value in self.cfg["algorithm"].items() if name != "class_name"}
        algorithm = FusedPPO.in_place_of(self.alg, self.generators.on(self.device), **settings)
        inner = self.env.env
        return Iteration(self.env, algorithm, None if inner.dump is not None else inner.capture)

    def _catch_up(self) -> None:
        """Copy newer weights from the iteration on the device to ``alg``."""
        if self._iteration is not None and self._is_behind:
            self._iteration.algorithm.copy_to(self.alg)
            self._is_behind = False

    def _iterate(self, end: int) -> dict[str, float]:
        """Run one iteration (collect, learn, exchange bodies, evaluate if due); return the row of metrics."""
        started = time.perf_counter()

        # Collect and learn; tensors and means that do not go into the row are in `logger`.
        if self._iteration is None:
            try:
                super().learn(1)
            except ActionError as error:
                raise self._diverged(str(error)) from error
            figures = self._figures_of_rsl_rl()
        else:
            figures = self._learn_on_device(self._iteration)

        # Exchange bodies
        if self.bodies is not None and self.bodies.refresh != "none":
            # in the same torch mode as the steps of the environments
            with torch.inference_mode() if self._iteration is None else torch.no_grad():
                self.bodies.exchange(self.env, self.logger.ended)
                self.alg.actor.reset(self.logger.ended)
                self.alg.critic.reset(self.logger.ended)

        # Check
        self._check(figures)
        seconds = time.perf_counter() - started
        self.current_learning_iteration += 1

        # Evaluate
        done = self.current_learning_iteration
        evaluated = math.nan
        if self._is_due(done, end):
            evaluated = self._evaluate()
        self.elapsed += time.perf_counter() - started
        return self._row(figures, seconds, evaluated)

    def _figures_of_rsl_rl(self) -> dict[str, float]:
        """Return the figures of rsl-rl's iteration, under the names of :meth:`Iteration.read`."""
        learned = [value for group in self.alg.optimizer.param_groups for value in group["params"]]
        learned += self.alg.get_policy().buffers()
        deviations: Any = self.alg.get_policy().distribution
        return {
            **self.logger.losses,
            "learning_rate": self.alg.learning_rate,
            # output_std has a 1 for each action that a body lacks
            "action_std": deviations.log_std_param.detach().clamp(*deviations.log_std_range).exp().mean().item(),
            "finite": float(torch.stack([torch.isfinite(value).all() for value in learned]).all()),
        }

    def _learn_on_device(self, iteration: Iteration) -> dict[str, float]:
        """Collect and learn with :class:`Iteration` instead of rsl-rl; return its figures."""
        began = time.perf_counter()
        iteration()
        self._is_behind = True
        launched = time.perf_counter()
        figures = iteration.read()
        spent = self.spent
        spent.launching += launched - began
        spent.waiting += time.perf_counter() - launched
        simulation, learning = iteration.seconds()
        spent.simulation += simulation
        spent.learning += learning
        self.logger.losses = {name: figures[name] for name in ("value", "surrogate", "entropy")}
        self.logger.means = {name: value for name, value in figures.items() if "/" in name}
        self.logger.ended = iteration.ended
        if self.bodies is not None:
            for ended, returns in zip(iteration.whole.cpu(), iteration.returns.cpu(), strict=True):
                self.bodies.record(ended, returns)
        if figures["not_finite_total"]:
            self.env.env.not_finite()  # warns
        return figures

    def _check(self, figures: dict[str, float]) -> None:
        """Raise DivergenceError if losses, weights or moments are NaN or infinite."""
        for name, value in self.logger.losses.items():
            if not math.isfinite(value):
                raise self._diverged(f"the {name} loss is {value}")
        if not figures["finite"]:
            raise self._diverged("the networks have weights that are NaN or infinite")

    def _diverged(self, reason: str) -> DivergenceError:
        """Build the DivergenceError for this iteration, with ``reason`` and advice."""
        return DivergenceError(
            f"Learning diverged in iteration {self.current_learning_iteration + 1} ({reason}); checkpoints hold what"
            " was before. Try a new run with a lower ppo.learning_rate, or with values of ppo nearer to the defaults."
        )

    def _evaluate(self) -> float:
        """Evaluate the policy without exploration, save it if best so far, and return the mean return.

        The result is NaN without an evaluator, and where the evaluation is started in a thread, while the GPU replays a
        graph and the host is idle. The first evaluation never runs in a thread, because it loads kernels.
        """
        is_replayed = self._iteration is not None and self._iteration.is_replayed
        if is_replayed and self._judged is not None and self.evaluator is not None and self._is_default_type_ours:
            policy = self.policy.double()
            content = self._policy_content()
            state = None if self.schedule.stop_return is None else self.state()
            self._evaluation = _Evaluation(self._thread.submit(self.evaluator, policy), content, state)
            return math.nan
        value = math.nan
        if self.group.is_main_process and self.evaluator is not None:
            self.alg.eval_mode()
            try:
                self._judged = self.evaluator(self.policy.double())
                value = self._judged.mean_return
            except ActionError as error:
                self.current_learning_iteration -= 1  # it is not complete
                raise self._diverged(str(error)) from error
        value = self.group.broadcast(value)
        if math.isnan(value):  # there is no evaluator
            return value
        self._keep_if_best(value, self.current_learning_iteration, self._policy_content)
        return value

    def _keep_if_best(self, value: float, iteration: int, policy: Callable[[], dict[str, Any]]) -> None:
        """Store ``value`` as ``last_return``; if best so far, write ``model_best.pt``."""
        self.last_return = value
        if value > self.best_return:
            self.best_return = value
            self.best_iteration = iteration
            if self.folder is not None and self.group.is_main_process and value >= self._kept:
                save_checkpoint(self.folder / BEST, policy() | {"eval_return": value})

    def _await_evaluation(self) -> None:
        """Wait for an evaluation in the thread, if any, and put the result into its iteration's row."""
        if self._evaluation is None:
            return
        evaluation = self._evaluation
        self._evaluation = None
        iteration = evaluation.policy["iter"]
        began = time.perf_counter()
        try:
            self._judged = evaluation.result.result()
        except ActionError as error:
            self._rows.clear()
            self.current_learning_iteration = iteration - 1
            raise self._diverged(str(error)) from error
        finally:
            self.elapsed += time.perf_counter() - began

        # If the goal is reached, undo the iterations that were run meanwhile.
        value = self._judged.mean_return
        goal = self.schedule.stop_return
        if goal is not None and value >= goal and self.current_learning_iteration > iteration:
            del self._rows[1:]
            with self._own_torch():
                self.set_state(evaluation.state or {})

        # Complete the rows; the first one belongs to the evaluation.
        self._keep_if_best(value, iteration, lambda: evaluation.policy)
        self._rows[0][0].update({"eval_return": value, **self._quantiles(value)})
        for row, _ in self._rows:
            row["best_return"] = self.best_return

    def _row(self, figures: dict[str, float], seconds: float, evaluated: float) -> dict[str, float]:
        """Build the ``metrics.csv`` row of this iteration."""
        return {
            "iteration": self.current_learning_iteration,
            "steps": self.steps,
            **self._episodes(figures),
            "eval_return": evaluated,
            "best_return": self.best_return,
            **self._quantiles(evaluated),
            "value_loss": figures["value"],
            "surrogate_loss": figures["surrogate"],
            "entropy": figures["entropy"],
            "learning_rate": figures["learning_rate"],
            "action_std": figures["action_std"],
            "steps_per_second": self.steps_per_iteration / seconds,
            "elapsed": self.elapsed,
        }

    def _quantiles(self, evaluated: float) -> dict[str, float]:
        """Return the 10, 50 and 90 % quantiles over bodies of the last evaluation; empty for one body."""
        fitness = () if math.isnan(evaluated) or self._judged is None else self._judged.fitness
        if len(fitness) < 2:
            return {}
        return {f"eval_q{share}": float(torch.quantile(fitness, share / 100)) for share in (10, 50, 90)}

    def _episodes(self, figures: dict[str, float]) -> dict[str, float]:
        """Return count, mean return, mean length and number of stopped episodes, over all processes."""
        own = self.env.pop_episodes() if self._iteration is None else self.env.episodes_of(figures)
        count = own["episodes"]
        sums = [count, *(count * own[name] if count else 0.0 for name in ("return", "length"))]
        count, *means, unstable, diverged = self.group.sum([*sums, own["unstable"], own["diverged"]])
        mean, length = (value / count if count else math.nan for value in means)
        stopped: dict[str, float] = {"unstable": int(unstable), "diverged": int(diverged)}
        return {"episodes": int(count), "return_mean": mean, "length_mean": length} | stopped

    def summary(self) -> dict[str, Any]:
        """Return the progress for ``summary.json``: iterations, steps, best and last return, times."""
        known = math.isfinite(self.best_return)
        return {
            "iterations": self.current_learning_iteration,
            "steps": self.steps,
            "best_return": self.best_return if known else None,
            "best_iteration": self.best_iteration if known else None,
            "last_return": self.last_return if math.isfinite(self.last_return) else None,
            "elapsed_seconds": round(self.elapsed, 3),
            **self._time_spent(),
        }

    def _time_spent(self) -> dict[str, Any]:
        """Return this process's time by activity, for the summary; empty before the first iteration."""
        shares = {name: round(share, 3) for name, share in self.spent.shares.items()}
        found: dict[str, Any] = {"time": shares} if shares else {}
        return found | ({"host_bound": self.spent.is_host_bound} if self.spent.launching else {})

    def _policy_content(self) -> dict[str, Any]:
        """Collect a checkpoint's content: networks, optimiser, iteration and the policy's specification."""
        self._catch_up()
        own = {"iter": self.current_learning_iteration, "infos": None, "policy": spec_dict(self.spec)}
        return self.alg.save() | own | {"eval_return": self.last_return, "trained_on": self.trained_on}

    def save_all(self) -> None:
        """Write ``model_<iteration>.pt`` and ``state.pt`` to the run's folder, if any."""
        if self.folder is not None and self.group.is_main_process:
            check_folder(self.folder)
            save_checkpoint(self.folder / f"model_{self.current_learning_iteration}.pt", self._policy_content())
        self.save_state()

    def save_state(self) -> None:
        """Write this process's training state to the run's folder, if any."""
        if self.folder is not None:
            check_folder(self.folder)
            save_checkpoint(self.state_file(self.folder / STATE), self.state())
        self.saved_iteration = self.current_learning_iteration

    def state(self) -> dict[str, Any]:
        """Return the complete training state, for :meth:`set_state`."""
        own = {
            "env": self.env.state(),
            "random": self.generators.state(),
            "elapsed": self.elapsed,
            "best_return": self.best_return,
            "best_iteration": self.best_iteration,
            "processes": self.group.size,
            "memory": self.alg.memory(),
        }
        if self.bodies is not None:
            own["bodies"] = self.bodies.state(self.env)
        return self._policy_content() | own

    def state_file(self, path: Path) -> Path:
        """Return this process's state file: ``path``, or a numbered file beside it in other processes."""
        return path if self.group.is_main_process else path.with_name(f"{path.stem}_{self.group.rank}{path.suffix}")

    def resume(self, path: Path) -> None:
        """Load networks from a checkpoint file, and the complete state from ``state.pt``, to continue training.

        From ``state.pt`` learning goes on exactly as if it had not been stopped. Any other checkpoint restores the
        networks, the optimiser and the schedule, with new episodes; later checkpoints are removed when learning begins.
        ``model_best.pt`` in the folder stays until there is a better policy.
        """
        content = load_checkpoint(path, self.device)
        with damaged(path):
            if "env" in content:
                if (processes := content.get("processes")) != self.group.size:
                    raise RunError(f"It was made by {processes} process(es) and can only go on with as many.")
                content = load_checkpoint(self.state_file(path), self.device)
            if (found := spec_of(content["policy"])) != self.spec:
                raise RunError(f"It holds another kind of policy: {found}, not {self.spec}.")
            self.set_state(content)
        if "env" not in content:
            self._turned_back = True
            times = [row["elapsed"] for row in read_metrics(path.parent) if row["iteration"] <= content["iter"]]
            self.elapsed = times[-1] if times else 0.0
        with contextlib.suppress(RunError):  # there may be none
            best = load_checkpoint(path.with_name(BEST))
            check_like(best, {"eval_return": float, "iter": int})
            self._kept = best["eval_return"]
            if self._turned_back:
                self.best_return = best["eval_return"]
                self.best_iteration = best["iter"]

    def begin_with(self, learned: Mapping[str, Any], optimizer: bool = False) -> None:
        """Load networks from another training's checkpoint, to start a new schedule.

        Args:
            optimizer: whether to load the optimiser's moments, and the learning rate that an adaptive schedule found.
        """
        check_fits(self.spec, spec_of(learned["policy"]))
        self._iteration = None
        try:
            self.alg.load(dict(learned), None if optimizer else {"actor": True, "critic": True})
        except RunError as error:  # such as a critic with other weights
            raise RunError(f"The pretrained policy has another kind of network: {error}") from None
        self.alg.updates = 0
        if self.ppo.schedule != "adaptive":
            self.alg.set_learning_rate(self.ppo.learning_rate)

    def set_state(self, content: dict[str, Any]) -> None:
        """Restore a :meth:`state`, or the content of ``model_<iteration>.pt`` with new episodes."""
        check_like(content, {"iter": int, "eval_return": float} | (COUNTERS if "env" in content else {}))
        self._iteration = None
        self.alg.load(content, None, True)
        self.current_learning_iteration = self.saved_iteration = content["iter"]
        self.last_return = content["eval_return"]
        if "env" not in content:
            return
        if self.bodies is not None:
            self.bodies.set_state(content["bodies"], self.env)
        self.env.set_state(content["env"])
        self.alg.set_memory(content["memory"])
        self.generators.set_state(content["random"])
        self.elapsed = content["elapsed"]
        self.best_return = content["best_return"]
        self.best_iteration = content["best_iteration"]
