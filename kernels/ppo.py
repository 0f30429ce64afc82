"""PPO between its matrix products: recording of a rollout, returns, losses with their gradients, and Adam.

Each function is one launch, because launches are what a small batch pays for on a GPU. Formulas are those of
:mod:`warpvox.algos.ppo.population`. Rows of a rollout are sorted by design; ``widths`` has the number of actions of
each design, beyond which actions are padded. No thread adds to what another one writes: the same input gives the same
bits.
"""

import math

import warp as wp

from warpvox.kernels.device import kernel

FIRST, SECOND = 0.9, 0.999
"""Decay rates of Adam's first and second moments per step: torch's defaults."""
SLOWEST, FASTEST = 1e-5, 1e-2
"""Bounds of the learning rate in rsl-rl's adaptive schedule."""
SUMS = 3
"""Sums of a minibatch besides those by action: KL divergence, value loss and surrogate loss."""

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


@wp.func
def log_std_of(log_std: wp.array2d(dtype=float), limits: wp.vec2, design: int, action: int):
    """Return the logarithm of the deviation of an action, within its limits."""
    return wp.clamp(log_std[design, action], limits[0], limits[1])


@kernel
def normalize(
    obs: wp.array2d(dtype=float),
    mean: wp.array2d(dtype=float),
    deviation: wp.array2d(dtype=float),
    eps: float,
    scaled: wp.array2d(dtype=float),
):
    """Subtract the means of observations ``[rows, entries]``, and divide by their deviations ``[designs, entries]``."""
    row, entry = wp.tid()
    design = row // (obs.shape[0] // mean.shape[0])
    scaled[row, entry] = (obs[row, entry] - mean[design, entry]) / (deviation[design, entry] + eps)


@kernel
def draw_actions(
    mean: wp.array2d(dtype=float),
    noise: wp.array2d(dtype=float),
    log_std: wp.array2d(dtype=float),
    limits: wp.vec2,
    widths: wp.array(dtype=int),
    means: wp.array2d(dtype=float),
    actions: wp.array2d(dtype=float),
    log_prob: wp.array(dtype=float),
):
    """Record actions drawn around ``mean`` ``[rows, actions]``, the means, and the log-probabilities of the actions."""
    row = wp.tid()
    design = row // (mean.shape[0] // log_std.shape[0])
    squares = float(0.0)
    constants = float(0.0)
    for action in range(mean.shape[1]):
        centre = mean[row, action]
        drawn = centre
        if action < widths[design]:
            log_deviation = log_std_of(log_std, limits, design, action)
            deviation = wp.exp(log_deviation)
            drawn = noise[row, action] * deviation + centre
            distance = (drawn - centre) / deviation
            squares = squares + distance * distance
            constants = constants + log_deviation + HALF_LOG_2PI
        means[row, action] = centre
        actions[row, action] = drawn
    log_prob[row] = squares * -0.5 - constants


@kernel
def record_step(
    reward: wp.array(dtype=float),
    done: wp.array(dtype=wp.bool),
    time_out: wp.array(dtype=wp.bool),
    final_value: wp.array(dtype=float),
    gamma: float,
    rewards: wp.array(dtype=float),
    dones: wp.array(dtype=wp.uint8),
):
    """Record rewards and ends of episodes; a time limit adds the discounted value of the final state.

    ``time_out`` and ``final_value`` are empty where a time limit is an end like any other.
    """
    row = wp.tid()
    value = reward[row]
    if time_out.shape[0] > 0:
        value = value + gamma * final_value[row] * wp.where(time_out[row], 1.0, 0.0)
    rewards[row] = value
    dones[row] = wp.where(done[row], wp.uint8(1), wp.uint8(0))


@kernel
def estimate_advantages(
    rewards: wp.array2d(dtype=float),
    dones: wp.array2d(dtype=wp.uint8),
    values: wp.array2d(dtype=float),
    last_values: wp.array(dtype=float),
    gamma: float,
    lam: float,
    returns: wp.array2d(dtype=float),
    advantages: wp.array2d(dtype=float),
):
    """Write returns and generalised advantages ``[steps, rows]``, from the last step to the first."""
    row = wp.tid()
    next_value = last_values[row]
    advantage = float(0.0)
    for back in range(rewards.shape[0]):
        step = rewards.shape[0] - 1 - back
        value = values[step, row]
        discount = wp.where(dones[step, row] == wp.uint8(0), gamma, 0.0)
        advantage = rewards[step, row] + discount * next_value - value + discount * lam * advantage
        returns[step, row] = advantage + value
        advantages[step, row] = returns[step, row] - value
        next_value = value


@wp.struct
class Minibatches:
    """The rollout, ``[designs, samples, ...]``, of which minibatches are slices, and the deviations that drew it."""

    actions: wp.array3d(dtype=float)
    mean: wp.array3d(dtype=float)
    log_prob: wp.array2d(dtype=float)
    values: wp.array2d(dtype=float)
    returns: wp.array2d(dtype=float)
    advantages: wp.array2d(dtype=float)
    old_log_std: wp.array2d(dtype=float)


@wp.struct
class Losses:
    """Settings of PPO's losses, as rsl-rl names them; ``clip_values`` is 1 for its clipped value loss."""

    clip: float
    value_coef: float
    clip_values: int
    entropy_coef: float
    limits: wp.vec2


@kernel
def differentiate_losses(
    data: Minibatches,
    settings: Losses,
    first: int,
    outputs: wp.array3d(dtype=float),
    log_std: wp.array2d(dtype=float),
    widths: wp.array(dtype=int),
    gradient: wp.array3d(dtype=float),
    terms: wp.array3d(dtype=float),
):
    """Differentiate the losses of a minibatch, which begins at sample ``first``, by the outputs of all networks.

    ``outputs`` and ``gradient`` ``[2 * designs, rows, actions]`` are those of policies, then those of value functions,
    which have one column. ``terms`` ``[designs, rows, actions + SUMS]`` are summed over rows by the caller: the
    gradients by the logarithms of deviations, then KL divergence, value loss and surrogate loss.
    """
    design, row = wp.tid()
    sample = first + row
    width = widths[design]
    columns = outputs.shape[2]
    share = 1.0 / float(outputs.shape[1])
    critic = log_std.shape[0] + design

    # Log-probability and divergence
    squares = float(0.0)
    constants = float(0.0)
    divergence = float(0.0)
    for action in range(width):
        log_deviation = log_std_of(log_std, settings.limits, design, action)
        deviation = wp.exp(log_deviation)
        noise = (data.actions[design, sample, action] - outputs[design, row, action]) / deviation
        squares = squares + noise * noise
        constants = constants + log_deviation + HALF_LOG_2PI
        # in torch's order, so that changes too small for it are exactly 0 here, too
        ratio = wp.exp(log_std_of(data.old_log_std, settings.limits, design, action)) / deviation
        ratio = ratio * ratio
        moved = (data.mean[design, sample, action] - outputs[design, row, action]) / deviation
        divergence = divergence + 0.5 * (moved * moved + ratio - 1.0 - wp.log(ratio))

    # Surrogate loss: its gradient is that of the larger of both losses; where they are equal, both gradients are
    ratio = wp.exp(squares * -0.5 - constants - data.log_prob[design, sample])
    advantage = data.advantages[design, sample]
    free = -advantage * ratio
    bounded = -advantage * wp.clamp(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    by_log_prob = wp.where(free >= bounded, free * share, 0.0)
    for action in range(columns):
        by_mean = float(0.0)
        by_log_std = float(0.0)
        if action < width:
            deviation = wp.exp(log_std_of(log_std, settings.limits, design, action))
            noise = (data.actions[design, sample, action] - outputs[design, row, action]) / deviation
            by_mean = noise * by_log_prob / deviation
            by_log_std = (noise * noise - 1.0) * by_log_prob
        gradient[design, row, action] = by_mean
        gradient[critic, row, action] = 0.0
        terms[design, row, action] = by_log_std

    # Value loss
    value = outputs[critic, row, 0]
    error = value - data.returns[design, sample]
    square = error * error
    slope = error * 2.0 * settings.value_coef * share
    if settings.clip_values != 0:
        old = data.values[design, sample]
        moved = value - old
        clipped = old + wp.clamp(moved, -settings.clip, settings.clip) - data.returns[design, sample]
        # beyond the bounds the clipped error does not depend on the value; within them both errors are the same
        if square < clipped * clipped and wp.abs(moved) > settings.clip:
            slope = 0.0
        square = wp.max(square, clipped * clipped)
    gradient[critic, row, 0] = slope

    terms[design, row, columns] = divergence * share
    terms[design, row, columns + 1] = square * share
    terms[design, row, columns + 2] = wp.max(free, bounded) * share


@kernel
def conclude_losses(
    sums: wp.array2d(dtype=float),
    settings: Losses,
    desired_kl: wp.float64,
    log_std: wp.array2d(dtype=float),
    widths: wp.array(dtype=int),
    by_log_std: wp.array2d(dtype=float),
    rates: wp.array(dtype=wp.float64),
    losses: wp.array2d(dtype=float),
):
    """Conclude a minibatch of each design: learning rate, gradient by the deviations, and sums of the losses.

    The rate follows rsl-rl's adaptive schedule; a ``desired_kl`` of 0 leaves it as it is. ``losses`` ``[3, designs]``
    are value loss, surrogate loss and entropy.
    """
    design = wp.tid()
    columns = log_std.shape[1]

    # Learning rate
    kl = wp.float64(sums[design, columns])
    if desired_kl > wp.float64(0.0):
        if kl > wp.float64(2.0) * desired_kl:
            rates[design] = wp.max(rates[design] / wp.float64(1.5), wp.static(wp.float64(SLOWEST)))
        elif kl < wp.float64(0.5) * desired_kl and kl > wp.float64(0.0):
            rates[design] = wp.min(rates[design] * wp.float64(1.5), wp.static(wp.float64(FASTEST)))

    # Gradient by the logarithms of deviations: none beyond their limits
    entropy = float(0.0)
    for action in range(widths[design]):
        value = log_std[design, action]
        is_free = value >= settings.limits[0] and value <= settings.limits[1]
        by_log_std[design, action] = wp.where(is_free, sums[design, action] - settings.entropy_coef, 0.0)
        entropy = entropy + log_std_of(log_std, settings.limits, design, action) + HALF_LOG_2PI + 0.5

    losses[0, design] = losses[0, design] + sums[design, columns + 1]
    losses[1, design] = losses[1, design] + sums[design, columns + 2]
    losses[2, design] = losses[2, design] + entropy


@kernel
def descend(
    gradient: wp.array2d(dtype=float),
    norms: wp.array(dtype=float),
    max_norm: float,
    rates: wp.array(dtype=wp.float64),
    corrections: wp.array(dtype=wp.float64),
    eps: float,
    values: wp.array2d(dtype=float),
    means: wp.array2d(dtype=float),
    squares: wp.array2d(dtype=float),
):
    """Do a step of Adam for each network, ``[networks, parameters]``, with its gradient clipped to ``max_norm``.

    ``rates`` has the learning rate of each design, whose networks are that many rows apart; ``corrections`` are the two
    of :meth:`warpvox.algos.ppo.adam.VectorAdam.prepare`.
    """
    network, k = wp.tid()
    scale = wp.min(max_norm / (norms[network] + 1.0e-6), 1.0)
    slope = gradient[network, k] * scale
    mean = means[network, k] + wp.static(1.0 - FIRST) * (slope - means[network, k])
    square = squares[network, k] * SECOND + wp.static(1.0 - SECOND) * slope * slope
    means[network, k] = mean
    squares[network, k] = square
    factor = float(corrections[0] / (corrections[1] * rates[network % rates.shape[0]]))
    root = wp.sqrt(square) + eps * float(corrections[1])
    values[network, k] = values[network, k] + mean / (root * factor)
