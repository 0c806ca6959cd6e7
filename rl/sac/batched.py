"""Networks of several SAC agents in shared tensors, with explicit forward and backward passes.

PyTorch's autograd runs a few hundred small kernels for one update of SAC, this about a hundred for
any number of agents. Weights have the layout of ``torch.nn.Linear``. C networks, B batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

_NORM_EPSILON = 1e-5


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


class Layers:
    """C multilayer perceptrons (ReLU) of one shape, their gradients and Adam's moments.

    ``sizes`` are the widths of all layers. With ``norm`` hidden layers are normalised before the
    ReLU, without gain and bias (Ba, Kiros, Hinton, "Layer normalization", arXiv 1607.06450).
    """

    def __init__(
        self, C: int, sizes: Sequence[int], device: torch.device, *, norm: bool = False
    ) -> None:
        pairs = list(zip(sizes[:-1], sizes[1:], strict=True))
        total = sum(C * (a + 1) * b for a, b in pairs)
        self.norm = norm
        self.flat, self.gradient = torch.zeros(2, total, device=device).unbind(0)
        # shapes (C, out, in) and (C, 1, out)
        self.weights, self.biases = _views(self.flat, C, pairs)
        self._weight_gradients, self._bias_gradients = _views(self.gradient, C, pairs)
        self.moments = torch.zeros(2, total, device=device)  # Adam's first and second
        self.count = torch.zeros(1, device=device)  # of updates

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
                h, mean, scale = torch.native_layer_norm(h, h.shape[2:], None, None, _NORM_EPSILON)
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

    def descend(self, rate: Tensor) -> None:
        """One step of Adam."""
        adam(self.flat, self.gradient, self.moments, self.count, rate)


def _views(
    vector: Tensor, C: int, pairs: Sequence[tuple[int, int]]
) -> tuple[list[Tensor], list[Tensor]]:
    """Weights and biases of each layer, of inputs and outputs ``pairs``, as parts of a vector."""
    sizes = [size for a, b in pairs for size in (C * a * b, C * b)]
    parts = vector.split_with_sizes(sizes)
    weights = [part.view(C, b, a) for part, (a, b) in zip(parts[::2], pairs, strict=True)]
    return weights, [part.view(C, 1, b) for part, (_, b) in zip(parts[1::2], pairs, strict=True)]


def adam(flat: Tensor, gradient: Tensor, moments: Tensor, count: Tensor, rate: Tensor) -> None:
    """Adam (Kingma and Ba, 2015, Algorithm 1), in place; parameters (P,), moments (2, P)."""
    count += 1
    torch._fused_adam_(  # noqa: SLF001 - what torch.optim.Adam(fused=True) calls
        [flat], [gradient], [moments[0]], [moments[1]], [], [count],
        lr=rate, beta1=0.9, beta2=0.999, weight_decay=0.0, eps=1e-8, amsgrad=False, maximize=False,
    )  # fmt: skip


def mirrored(odd: Sequence[float], J: int, device: torch.device) -> Tensor:
    """1 for each column of a transition that changes sign under mirroring; see ``View.odd``."""
    return torch.tensor([*odd, *[1.0] * J, 0.0, 0.0, *odd, 0.0], device=device)
