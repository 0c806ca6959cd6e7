"""Soft actor-critic for a batch of agents; on CUDA an update is one captured graph.

Haarnoja et al., "Soft Actor-Critic Algorithms and Applications" (arXiv 1812.05905). With the
settings ``PLAIN`` it equals Stable-Baselines3 up to rounding, whose models hold the parameters.
Networks of all agents share tensors and have explicit forward and backward passes: PyTorch's
autograd runs a few hundred small kernels for one update, this about a hundred for any number of
agents. A agents, B batch, C networks, N memory, O observation, J action.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from rl.sac.plan import Settings

if TYPE_CHECKING:
    from rl.sac.sac import SwimSAC

_SMALL = 1e-6
_LOG_STD = (-20.0, 2.0)


@dataclass(frozen=True)
class Activations:
    """Results of a forward pass that the backward pass needs."""

    layers: list[Tensor]  # input, hidden layers and output, each (C, B, width)
    # for each normalised hidden layer: input of the normalization, mean, 1 / deviation
    sums: list[tuple[Tensor, Tensor, Tensor]]

    @property
    def output(self) -> Tensor:
        """Shape (C, B, width)."""
        return self.layers[-1]

    def first(self, B: int) -> Activations:
        """The first rows of the batch."""
        sums = [(a[:, :B], b[:, :B], c[:, :B]) for a, b, c in self.sums]
        return Activations([layer[:, :B] for layer in self.layers], sums)


class Parameters:
    """Parameters in one vector, with their gradient and Adam's moments."""

    def __init__(self, size: int, device: torch.device) -> None:
        self.flat, self.gradient = torch.zeros(2, size, device=device).unbind(0)
        self.moments = torch.zeros(2, size, device=device)  # first and second
        self.count = torch.zeros(1, device=device)  # of updates

    def descend(self, rate: Tensor) -> None:
        """One step of Adam (Kingma and Ba, 2015, Algorithm 1)."""
        self.count += 1
        first, second = self.moments
        torch._fused_adam_(  # noqa: SLF001 - what torch.optim.Adam(fused=True) calls
            [self.flat], [self.gradient], [first], [second], [], [self.count], lr=rate, beta1=0.9,
            beta2=0.999, weight_decay=0.0, eps=1e-8, amsgrad=False, maximize=False,
        )  # fmt: skip


class Layers(Parameters):
    """C multilayer perceptrons (ReLU) of one shape.

    ``sizes`` are the widths of all layers. With ``norm`` hidden layers are normalised before the
    ReLU, without gain and bias (Ba, Kiros, Hinton, "Layer normalization", arXiv 1607.06450).
    """

    def __init__(
        self, C: int, sizes: Sequence[int], device: torch.device, *, norm: bool = False
    ) -> None:
        pairs = list(zip(sizes[:-1], sizes[1:], strict=True))
        super().__init__(sum(C * (a + 1) * b for a, b in pairs), device)
        self.norm = norm
        sizes_of_parts = [size for a, b in pairs for size in (C * a * b, C * b)]

        def views(vector: Tensor) -> tuple[list[Tensor], list[Tensor]]:
            """Weights (C, out, in) and biases (C, 1, out) of each layer, as parts of a vector."""
            parts = vector.split_with_sizes(sizes_of_parts)
            weights = [part.view(C, b, a) for part, (a, b) in zip(parts[::2], pairs, strict=True)]
            return weights, [part.view(C, 1, -1) for part in parts[1::2]]

        self.weights, self.biases = views(self.flat)
        self._weight_gradients, self._bias_gradients = views(self.gradient)

    def forward(self, x: Tensor) -> Activations:
        """Forward pass from inputs of shape (C, B, width)."""
        activations = Activations([x], [])
        last = len(self.weights) - 1
        for k, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = activations.layers[-1]
            if W.shape[1] == 1:  # faster on a CPU than a product with one column
                h = torch.bmm(W, x.transpose(1, 2)).transpose(1, 2) + b
            else:
                h = torch.baddbmm(b, x, W.transpose(1, 2))
            if self.norm and k < last:
                unnormalised = h
                h, mean, scale = torch.native_layer_norm(h, h.shape[2:], None, None, 1e-5)
                activations.sums.append((unnormalised, mean, scale))
            activations.layers.append(h if k == last else torch.relu_(h))
        return activations

    def backward(self, activations: Activations, d: Tensor, *, inputs_only: bool = False) -> Tensor:
        """Gradient of the input from that of the output, (C, B, width); sets ``gradient`` too."""
        for k in range(len(self.weights) - 1, -1, -1):
            if not inputs_only:
                torch.bmm(d.transpose(1, 2), activations.layers[k], out=self._weight_gradients[k])
                torch.sum(d, dim=1, keepdim=True, out=self._bias_gradients[k])
            if k == 0 and not inputs_only:
                return d
            W = self.weights[k]
            d = d * W if W.shape[1] == 1 else torch.bmm(d, W)
            if k > 0:
                torch.ops.aten.threshold_backward.grad_input(  # in place
                    d, activations.layers[k], 0.0, grad_input=d
                )
                if self.norm:
                    unnormalised, mean, scale = activations.sums[k - 1]
                    d = torch.ops.aten.native_layer_norm_backward(
                        d, unnormalised, d.shape[2:], mean, scale, None, None, [True, False, False]
                    )[0]
        return d


def mirrored(odd: Sequence[float], J: int, device: torch.device) -> Tensor:
    """1 for each column of a transition that changes sign under mirroring; see ``View.odd``."""
    return torch.tensor([*odd, *[1.0] * J, 0.0, 0.0, *odd, 0.0], device=device)


@dataclass(frozen=True)
class Batch:
    """Transitions, each (A, B, ...); ``done`` where the episode terminated (not truncated)."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    following: Tensor
    done: Tensor


class Agents:
    """Agents that learn in parallel, each from its own memory."""

    def __init__(self, models: Sequence[SwimSAC], settings: Settings, device: torch.device) -> None:
        """Copy the parameters of models of the same shape to ``device``."""
        # of Stable-Baselines3; their parameters become views of the shared ones
        self.models, self.settings, self.device = list(models), settings, device
        A, first = len(self.models), self.models[0]
        self.O, self.J = first.view.size(len(first.joints)), len(first.joints)
        hidden = settings.hidden
        extra = int(settings.prices > 1)  # the price, in the first column
        self.actor = Layers(A, (extra + self.O, *hidden, 2 * self.J), device)
        sizes, norm = (extra + self.O + self.J, *hidden, 1), settings.norm
        self.critic = Layers(2 * A, sizes, device, norm=norm)
        self.target = Layers(2 * A, sizes, device, norm=norm)
        self.log_alpha = Parameters(A, device)
        for a, model in enumerate(self.models):
            self._share(a, model)
        self.average = self.actor.flat.clone() if settings.average else self.actor.flat
        # of energy, present, also for old transitions
        self.price = torch.zeros(A, 1, device=device)
        self._rate = torch.tensor(settings.rate, device=device)
        self._entropy = torch.full((A,), self.J * settings.entropy_target[0], device=device)
        # observation, action, reward without energy, energy, next observation, whether terminated
        width = 2 * self.O + self.J + 3
        self.memory = torch.zeros(A, settings.memory, width, device=device)
        self.position, self.filled = 0, 0  # of transitions, the same for every agent
        self._filled = torch.zeros(1, device=device)
        self._odd = mirrored(first.view.odd(self.J), self.J, device)
        self._agent = torch.arange(A, device=device)[:, None]
        self._graph: torch.cuda.CUDAGraph | None = None

    def _share(self, a: int, model: SwimSAC) -> None:
        """Make the parameters of a model views of the shared ones, keeping their values."""

        def tie(linear: Any, layers: Layers, k: int, c: int, rows: slice) -> None:  # noqa: ANN401
            columns = slice(-linear.in_features, None)
            weight, bias = layers.weights[k][c, rows, columns], layers.biases[k][c, 0, rows]
            weight.copy_(linear.weight.data)
            bias.copy_(linear.bias.data)
            linear.weight.data, linear.bias.data = weight, bias

        all_rows, J = slice(None), self.J
        actor: Any = model.actor
        for k in range(len(self.settings.hidden)):
            tie(actor.latent_pi[2 * k], self.actor, k, a, all_rows)
        tie(actor.mu, self.actor, len(self.settings.hidden), a, slice(0, J))
        tie(actor.log_std, self.actor, len(self.settings.hidden), a, slice(J, 2 * J))
        for critic, layers in ((model.critic, self.critic), (model.critic_target, self.target)):
            networks: Any = critic.q_networks
            for i, network in enumerate(networks):
                linear = [module for module in network if isinstance(module, nn.Linear)]
                for k, module in enumerate(linear):
                    tie(module, layers, k, 2 * a + i, all_rows)
        log_alpha: Any = model.log_ent_coef
        self.log_alpha.flat[a : a + 1].copy_(log_alpha.data)
        log_alpha.data = self.log_alpha.flat[a : a + 1]

    @torch.no_grad()
    def act(self, observation: Tensor, noise: Tensor | None = None) -> Tensor:
        """Actions between -1 and 1, shape (A, n, J), for observations (A, n, O).

        ``noise`` are standard normal numbers (A, n, J), None for the mean action. With noise the
        observed prices range from lowest to highest, without it all are the default.
        """
        if self.settings.prices > 1:
            A, n, _ = observation.shape
            price = torch.linspace(-1, 1, n, device=self.device) * (noise is not None)
            observation = torch.cat([price.expand(A, n)[..., None], observation], dim=2)
        if noise is None:
            noise = torch.zeros(*observation.shape[:2], self.J, device=self.device)
        return self._policy(observation, noise)[1]

    def remember(
        self,
        observation: Tensor,
        action: Tensor,
        gain: Tensor,
        effort: Tensor,
        following: Tensor,
        done: Tensor,
    ) -> None:
        """Store n transitions of each agent, arrays of shape (A, n, ...)."""
        n, N = observation.shape[1], self.settings.memory
        rewards = torch.stack([gain, effort], dim=2)
        parts = [observation, action, rewards, following, done[..., None].float()]
        places = (self.position + torch.arange(n, device=self.device)) % N
        self.memory[:, places] = torch.cat(parts, dim=2)
        self.position = (self.position + n) % N
        self.set_filled(min(self.filled + n, N))

    def set_filled(self, filled: int) -> None:
        """Set the number of stored transitions."""
        self.filled = filled
        self._filled.fill_(filled)

    def set_schedule(self, share: float, grown: Sequence[float]) -> None:
        """Set learning rate by the completed ``share``, target entropy also by ``Plan.grown``."""
        s = self.settings
        self._rate.fill_(s.rate * (1 + (s.rate_end - 1) * share))
        initial, final = s.entropy_target
        targets = [self.J * (initial + (final - initial) * min(one, share)) for one in grown]
        self._entropy.copy_(torch.tensor(targets))

    @contextmanager
    def averaged(self) -> Iterator[None]:
        """Context manager within which the actors are the averaged ones, for saving."""
        trained = self.actor.flat.clone()
        self.actor.flat.copy_(self.average)
        try:
            yield
        finally:
            self.actor.flat.copy_(trained)

    def learn(self, updates: int) -> None:
        """Perform a number of updates of every agent, each from its own memory."""
        if self.device.type != "cuda":
            for _ in range(updates):
                self.update(self._sample())
            return
        if self._graph is None:
            self._capture()
        for _ in range(updates):
            self._graph.replay()  # type: ignore[union-attr]

    def _sample(self) -> Batch:
        shape, n = (len(self.models), self.settings.batch), self.O
        chosen = (torch.rand(shape, device=self.device) * self._filled).long()
        rows = self.memory[self._agent, chosen]
        if self.settings.mirror:
            side = 1 - 2 * (torch.rand(*shape, 1, device=self.device) < 0.5).float()
            rows = rows * (self._odd * side + (1 - self._odd))
        a = n + self.J
        observation, following, price = rows[..., :n], rows[..., a + 2 : -1], self.price
        if self.settings.prices > 1:
            share = 2 * torch.rand(*shape, 1, device=self.device) - 1
            price = price * self.settings.prices ** share[..., 0]
            observation = torch.cat([share, observation], 2)
            following = torch.cat([share, following], 2)
        reward = rows[..., a] - price * rows[..., a + 1]
        return Batch(observation, rows[..., n:a], reward, following, rows[..., -1])

    @torch.no_grad()
    def update(self, batch: Batch, noise: tuple[Tensor, Tensor] | None = None) -> None:
        """One update of all agents, with normal ``noise`` of both actions, (A, B, J) each."""
        s, A, B = self.settings, len(self.models), batch.reward.shape[1]
        if noise is None:
            normal = torch.randn(A, 2 * B, self.J, device=self.device)
        else:
            normal = torch.cat(noise, dim=1)
        pair = torch.cat([batch.observation, batch.following], dim=1)
        activations, actions, log_ps, std = self._policy(pair, normal)
        activations = activations.first(B)
        action, next_action = actions[:, :B], actions[:, B:]
        log_p = log_ps[:, :B]
        alpha = self.log_alpha.flat.exp()[:, None]
        torch.neg(self._entropy + log_p.mean(dim=1), out=self.log_alpha.gradient)

        _, next_q = self._values(self.target, batch.following, next_action)
        value = next_q.amin(dim=1) - alpha * log_ps[:, B:]
        goal = torch.addcmul(batch.reward, 1 - batch.done, value, value=s.gamma)
        passed, q = self._values(self.critic, batch.observation, batch.action)
        self.critic.backward(passed, (q - goal[:, None]).view(2 * A, B, 1) / B)
        self.critic.descend(self._rate)

        passed, q = self._values(self.critic, batch.observation, action)
        first = (q[:, :1] <= q[:, 1:]).float() / -B  # where the first critic has the minimum
        pick = torch.cat([first, -1 / B - first], dim=1)
        d = self.critic.backward(passed, pick.view(2 * A, B, 1), inputs_only=True)
        by_action = d.view(A, 2, B, -1)[..., -self.J :].sum(dim=1)
        # gradient of mean(alpha log p - min q) through a = tanh(mean + std noise)
        weight, slope = alpha[..., None] / B, 1 - action**2
        by_mean = weight * 2 * action * slope / (slope + _SMALL) + by_action * slope
        raw = activations.output[..., self.J :]
        unclamped = (raw > _LOG_STD[0]) & (raw < _LOG_STD[1])
        by_log_std = (by_mean * (normal * std)[:, :B] - weight) * unclamped
        self.actor.backward(activations, torch.cat([by_mean, by_log_std], dim=2))
        self.actor.descend(self._rate)
        self.log_alpha.descend(self._rate)
        self.target.flat.lerp_(self.critic.flat, s.tau)
        if s.average:
            # weight of update t proportional to t^(1 / average - 1), normalised by the sum so far
            self.average.lerp_(self.actor.flat, 1 / (1 + s.average * (self.actor.count - 1)))

    @torch.no_grad()
    def losses(self) -> Tensor:
        """Losses of actor and critic on a new batch, and entropy coefficient, shape (3, A)."""
        shape, batch = (len(self.models), self.settings.batch, self.J), self._sample()
        alpha = self.log_alpha.flat.exp()[:, None]

        def drawn(observation: Tensor, critic: Layers) -> tuple[Tensor, Tensor]:
            noise = torch.randn(shape, device=self.device)
            _, action, log_p, _ = self._policy(observation, noise)
            return self._values(critic, observation, action)[1].amin(dim=1), alpha * log_p

        q, entropy = drawn(batch.observation, self.critic)
        next_q, next_entropy = drawn(batch.following, self.target)
        goal = batch.reward + (1 - batch.done) * self.settings.gamma * (next_q - next_entropy)
        error = self._values(self.critic, batch.observation, batch.action)[1] - goal[:, None]
        critic = 0.5 * (error**2).mean(dim=2).sum(dim=1)
        return torch.stack([(entropy - q).mean(1), critic, alpha[:, 0]])

    def _policy(
        self, observation: Tensor, noise: Tensor
    ) -> tuple[Activations, Tensor, Tensor, Tensor]:
        """Layers, actions (A, B, J), their log-probabilities (A, B), standard deviations."""
        activations = self.actor.forward(observation)
        mean, raw = activations.output[..., : self.J], activations.output[..., self.J :]
        log_std = raw.clamp(*_LOG_STD)
        std = log_std.exp()
        action = torch.tanh(mean + std * noise)
        density = -0.5 * noise**2 - log_std - torch.log(1 - action**2 + _SMALL)
        return activations, action, density.sum(dim=2) - 0.5 * self.J * math.log(2 * math.pi), std

    def _values(
        self, critics: Layers, observation: Tensor, action: Tensor
    ) -> tuple[Activations, Tensor]:
        """Layers and values (A, 2, B) of both critics of each agent."""
        x = torch.cat([observation, action], dim=2)
        twice = x[:, None].expand(-1, 2, -1, -1).reshape(2 * x.shape[0], *x.shape[1:])
        passed = critics.forward(twice)
        return passed, passed.output.view(len(self.models), 2, -1)

    def _capture(self) -> None:
        """Capture an update as a CUDA graph; changes by the warm-up are undone."""
        state = self.state()
        saved = {name: tensor.clone() for name, tensor in state.items()}
        random = torch.cuda.get_rng_state(self.device)
        torch.backends.cuda.matmul.allow_tf32 = False
        for _ in range(3):
            self.update(self._sample())
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, stream=torch.cuda.current_stream()):
            self.update(self._sample())
        for name, tensor in state.items():
            tensor.copy_(saved[name])
        torch.cuda.set_rng_state(random, self.device)
        self._graph = graph

    def state(self) -> dict[str, Tensor]:
        """All tensors that an update changes, by name; not copies."""
        networks = {"actor": self.actor, "critic": self.critic, "target": self.target}
        out = {"log_alpha": self.log_alpha.flat, "average": self.average}
        for name, one in {"alpha": self.log_alpha, **networks}.items():
            out |= {f"{name}_moments": one.moments, f"{name}_count": one.count}
        return out | {name: one.flat for name, one in networks.items()}
