"""Policies of agents trained with Stable-Baselines3, exported to NumPy, C and ONNX."""

import math
import os
import warnings
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC
from torch import Tensor, nn

from rl import observer
from rl.deploy.policy import Policy, npz
from rl.observer import PAPER, Observer, observation_bounds, observation_names
from rl.sac.sac import read_agent
from sim2real.arrays import Array32
from sim2real.errors import InputError, library
from sim2real.output import check_writable, provenance, write_whole
from sim2real.velocity import NEWEST


def read_zip(
    path: str | os.PathLike[str], *, seed: int | None = None, price: float | None = None
) -> Policy:
    """Read the policy of an SAC agent; nothing in the file is executed, see ``rl.sac.policy_zip``.

    ``price`` is that of energy relative to the training's, by default that of the file; ``seed`` is
    for the provenance. Networks are fully connected, with ReLU; all else is an InputError.
    """
    agent = read_agent(path)
    if price is not None:
        set_price(agent, price, where=str(path))
    return policy_of(agent, where=str(path), note=provenance([Path(path)], seed))


def set_price(agent: SAC, price: float, *, where: str = "agent") -> None:
    """Set another price of energy, relative to the training's: a constant input of the actor."""
    by_price: dict[str, Any] = getattr(agent, "by_price", {})
    prices = by_price.get("prices", 1.0)
    if not 1 / prices <= price <= prices:
        expected = f"{1 / prices:g} to {prices:g}" if prices > 1 else "1, as in training"
        raise InputError(where, "price", f"{price:g}", expected)
    if prices > 1:
        actor: Any = agent.actor
        share, bias = math.log(price) / math.log(prices), actor.latent_pi[0].bias.data
        bias += bias.new_tensor(by_price["column"]) * (share - by_price["share"])
        by_price["share"] = share


def policy_of(agent: SAC, *, where: str = "agent", note: Mapping[str, Any] | None = None) -> Policy:
    """The policy of an SAC agent with its joints' angles; actions of other agents are in rad."""
    actor: Any = agent.actor
    layers: list[nn.Linear] = [*actor.latent_pi[::2], actor.mu]
    attributes, box = vars(agent), agent.action_space
    low, high, joints = box.low, box.high, attributes.get("joints")  # type: ignore[attr-defined]
    if joints is None:
        joints = [f"j{k + 1}" for k in range(len(low))]
    else:
        lowest, span = agent.joint_low, agent.joint_high - agent.joint_low  # type: ignore[attr-defined]
        low, high = (lowest + (end + 1) / 2 * span for end in (low, high))
    view, spread = attributes.get("view", PAPER), attributes.get("trained_over")
    F, J = layers[0].in_features, len(low)
    if view.size(J) != F:
        problem = f"{F} columns for {J} joints"
        raise InputError(where, "observation", problem, f"{view.size(J)}, as in its view")
    return Policy(
        weights=tuple(layer.weight.detach().cpu().numpy().copy() for layer in layers),
        biases=tuple(layer.bias.detach().cpu().numpy().copy() for layer in layers),
        low=np.asarray(low, dtype=np.float32),
        high=np.asarray(high, dtype=np.float32),
        joints=tuple(map(str, joints)),
        observation=tuple(observation_names(joints)),
        observation_limit=np.array(observation_bounds(J), dtype=np.float32),
        view=view,
        provenance={**(note or {}), **({"trained_over": spread} if spread else {})},
    )


_DOC = """One decision. observation (N, O): {columns}. begin (N, 1): 1 where a swim starts, else 0.
memory (N, M): result of the last call; arbitrary where a swim starts. set_points (N, {period}, J):
desired angles in rad of {joints} for the next {period} periods of 20 ms; if frames were lost and
the decision is k periods late, send from number k on and decide again {period} - k later."""


class _Decision(nn.Module):
    """``rl.observer.Observer``: begin, observe, decide, and set-points until the next decision."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy
        layers: list[nn.Module] = []
        for weight, bias in zip(policy.weights, policy.biases, strict=True):
            linear = nn.Linear(*weight.shape[::-1])
            linear.weight.data, linear.bias.data = torch.tensor(weight), torch.tensor(bias)
            layers += [linear, nn.ReLU()]
        self.network = nn.Sequential(*layers[:-1], nn.Tanh())

    def forward(self, observation: Tensor, memory: Tensor, begin: Tensor) -> tuple[Tensor, Tensor]:
        policy, limit = self.policy, torch.tensor(self.policy.observation_limit)
        raw = torch.minimum(torch.maximum(observation, -limit), limit)
        # the exporter's atan2 takes 0 to the left for a little to the right
        left = torch.where(raw[:, -1:] == 0, torch.finfo(raw.dtype).tiny, raw[:, -1:])
        raw = torch.cat([raw[:, :-1], left], 1)
        low, high = torch.tensor(policy.low), torch.tensor(policy.high)
        state = Observer(policy.view, low, high, len(observation))
        state.remember(memory)
        state.begin(raw, begin[:, 0] > 0.5)
        state.decide(self.network(state.observe(raw)))
        ticks = range(policy.view.period)
        return torch.stack([state.set_points(k) for k in ticks], 1), state.memory()


def onnx_model(policy: Policy) -> bytes:
    """The policy as ONNX, float32; InputError without the package ``onnx``."""
    onnx = library("onnx", "--format")
    O, J, M = len(policy.observation), len(policy.joints), max(policy.view.memory, 2)  # noqa: E741
    names = ["observation", "memory", "begin"], ["set_points", "next_memory"]
    examples = tuple(torch.zeros(2, width) for width in (O, M * J + 2, 1))
    stream: Any = BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that needs no further package is the old one
        torch.onnx.export(
            _Decision(policy), examples, stream, dynamo=False, opset_version=17,
            input_names=names[0], output_names=names[1],
            dynamic_axes={name: {0: "N"} for name in (*names[0], *names[1])},
        )  # fmt: skip
    model = onnx.load_from_string(stream.getvalue())
    model.graph.name, model.producer_name = "policy", "sim2real"
    columns, joints = ", ".join(policy.observation), ", ".join(policy.joints)
    model.graph.doc_string = _DOC.format(columns=columns, joints=joints, period=policy.view.period)
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


_TEMPLATE = """\
/* A swimming policy, written by 'sim2real export'. C99; also C++. No allocation.
 *
 * policy_begin(&memory, observation), once at the start; then, 50 times per second,
 * policy(&memory, 1, observation, action): desired joint angles in rad from measurements.
 * The second argument is the number of control periods of 20 ms since the last call, more than
 * one if a measurement was lost. {floats} constants of 4 bytes; {stack} bytes of stack.
{comment}
 */
#ifndef SIM2REAL_POLICY_H
#define SIM2REAL_POLICY_H

#include <math.h>

#define POLICY_PERIOD {period}

/* State: decisions between -1 and 1, the newest first; the bearing; the side of the last stroke;
 * control periods since the last decision, -1 before the first. */
typedef struct {{
    float decisions[{K}][{J}], bearing, side;
    int since;
}} policy_memory;

{arrays}

static const int policy_widths[] = {{{widths}}};
static const float *const policy_weights[] = {{{weights}}};
static const float *const policy_biases[] = {{{biases}}};

/* Linear layers y = W x + b with ReLU between them, and tanh of the last. */
static void policy_network(const float inputs[{F}], float action[{J}]) {{
    float buffers[2][{widest}];
    const float *x = inputs;
    for (int k = 0; k < {layers}; k++) {{
        const int is_output = k == {layers} - 1, width = policy_widths[k];
        float *y = is_output ? action : buffers[k % 2];
        for (int i = 0; i < policy_widths[k + 1]; i++) {{
            float sum = policy_biases[k][i];
            for (int j = 0; j < width; j++) {{
                sum += policy_weights[k][i * width + j] * x[j];
            }}
            y[i] = is_output ? tanhf(sum) : sum > 0.0f ? sum : 0.0f;
        }}
        x = y;
    }}
}}

static float policy_clip(float x, float limit) {{
    return x > limit ? limit : x < -limit ? -limit : x;
}}

static float policy_bearing(const float observation[{O}]) {{
    return atan2f(policy_clip(observation[{O} - 1], policy_limit[{O} - 1]),
                  policy_clip(observation[{O} - 2], policy_limit[{O} - 2]));
}}

/* An angle of joint j as a share of its range, -1 and 1 at the ends. */
static float policy_share(const float observation[{O}], int j) {{
    const float span = policy_high_rad[j] - policy_low_rad[j];
    const float angle = policy_clip(observation[3 + j], policy_limit[3 + j]);
    return 2.0f * (angle - policy_low_rad[j]) / span - 1.0f;
}}

static void policy_begin(policy_memory *memory, const float observation[{O}]) {{
    for (int j = 0; j < {J}; j++) {{
        for (int k = 0; k < {K}; k++) {{
            memory->decisions[k][j] = policy_clip(policy_share(observation, j), 1.0f);
        }}
    }}
    memory->bearing = policy_bearing(observation);
    memory->side = memory->bearing < 0.0f ? -1.0f : 1.0f;
    memory->since = -1;
}}

/* The {F} inputs of the policy; the bearing has a hysteresis beyond pi. */
static void policy_inputs(policy_memory *memory, const float observation[{O}], float inputs[{F}]) {{
    float clipped[{O}], bearing = policy_bearing(observation);
    int n = 0;
    for (int i = 0; i < {O}; i++) {{
        clipped[i] = policy_clip(observation[i], policy_limit[i]);
    }}
    const float wrapped = bearing > 0.0f ? bearing - {turn} : bearing + {turn};
    if (bearing * memory->bearing < 0.0f && fabsf(wrapped) <= {kept}) {{
        bearing = wrapped;
    }}
    memory->bearing = bearing;
    if ({scaled}) {{
        const float ahead = clipped[{O} - 2], left = clipped[{O} - 1];
        const float distance = sqrtf(ahead * ahead + left * left);
        inputs[n++] = clipped[0] / {surge};
        inputs[n++] = clipped[1] / {sway};
        inputs[n++] = clipped[2] / {yaw};
        for (int j = 0; j < {J}; j++) {{
            inputs[n++] = policy_share(observation, j);
        }}
        for (int j = 0; j < {J}; j++) {{
            inputs[n++] = clipped[3 + {J} + j] / {rate};
        }}
        inputs[n++] = sinf(bearing);
        inputs[n++] = cosf(bearing);
        inputs[n++] = logf((distance + {near}) / {half});
        for (int i = 0; i < n; i++) {{
            inputs[i] = policy_clip(inputs[i], {largest});
        }}
    }} else {{
        for (; n < {O}; n++) {{
            inputs[n] = clipped[n];
        }}
    }}
    if ({sides}) {{
        inputs[n++] = bearing / {pi};
        inputs[n++] = memory->side;
    }}
    for (int k = 0; k < {memory}; k++) {{
        for (int j = 0; j < {J}; j++) {{
            inputs[n++] = memory->decisions[k][j];
        }}
    }}
}}

static void policy_decide(policy_memory *memory, const float observation[{O}]) {{
    float inputs[{F}], decision[{J}], mean = 0.0f;
    policy_inputs(memory, observation, inputs);
    policy_network(inputs, decision);
    for (int j = 0; j < {J}; j++) {{
        mean += decision[j] / {J}.0f;
        for (int k = {K} - 1; k > 0; k--) {{
            memory->decisions[k][j] = memory->decisions[k - 1][j];
        }}
        memory->decisions[0][j] = decision[j];
    }}
    if (fabsf(mean) > {stroke}) {{
        memory->side = mean > 0.0f ? 1.0f : -1.0f;
    }}
}}

static void policy(policy_memory *memory, int periods, const float observation[{O}],
                   float action[{J}]) {{
    int due = memory->since < 0;
    memory->since = due ? 0 : memory->since + periods;
    due = due || memory->since >= POLICY_PERIOD;
    memory->since %= POLICY_PERIOD;
    if (due) {{
        policy_decide(memory, observation);
    }}
    for (int j = 0; j < {J}; j++) {{
        float current = memory->decisions[0][j];
        if ({ramp}) {{
            const float before = memory->decisions[1][j];
            current = before + (current - before) * (float)(memory->since + 1) / POLICY_PERIOD;
        }}
        action[j] = policy_low_rad[j]
            + (current + 1.0f) / 2.0f * (policy_high_rad[j] - policy_low_rad[j]);
    }}
}}

#endif
"""


def c_header(policy: Policy) -> str:
    """The content of ``policy.h``: constants, and a function from observation to action."""
    arrays = {"policy_low_rad": policy.low, "policy_high_rad": policy.high}
    arrays["policy_limit"] = policy.observation_limit
    layers = range(len(policy.weights))
    for k in layers:
        arrays[f"policy_weight_{k}"] = policy.weights[k]
        arrays[f"policy_bias_{k}"] = policy.biases[k]
    view, O, J = policy.view, len(policy.observation), len(policy.joints)  # noqa: E741
    F = view.size(J)
    widths = [F, *(len(bias) for bias in policy.biases)]
    widest = max(widths[1:-1], default=1)
    numbers = {
        "surge": observer.SURGE_M_S, "sway": observer.SWAY_M_S, "yaw": observer.YAW_RAD_S,
        "rate": observer.RATE_RAD_S, "near": observer.NEAR_M, "half": observer.HALF_M,
        "largest": observer.LARGEST, "kept": observer.KEPT_RAD, "stroke": observer.STROKE,
        "turn": 2 * np.pi, "pi": np.pi,
    }  # fmt: skip
    return _TEMPLATE.format(
        floats=sum(array.size for array in arrays.values()),
        stack=4 * (2 * widest + F + O + 2 * J),
        comment=_comment(policy),
        arrays="\n\n".join(_constants(name, array) for name, array in arrays.items()),
        widths=", ".join(map(str, widths)),
        weights=", ".join(f"policy_weight_{k}" for k in layers),
        biases=", ".join(f"policy_bias_{k}" for k in layers),
        layers=len(layers), widest=widest, period=view.period, memory=view.memory,
        scaled=int(view.scaled), sides=int(view.sides), ramp=int(view.ramp),
        K=max(view.memory, 2), O=O, F=F, J=J,
        **{name: _number(np.float32(value)) for name, value in numbers.items()},
    )  # fmt: skip


def _comment(policy: Policy) -> str:
    """Order and units of observation and action, and origin."""
    limits = zip(policy.observation, policy.observation_limit, strict=True)
    ranges = zip(policy.joints, policy.low, policy.high, strict=True)
    origin = dict(policy.provenance.get("inputs", {}))
    lines = [
        "",
        "Names end with the unit; ahead and left are the position of the target in the body's",
        f"frame. Velocities are slopes of a line fitted to the last {NEWEST} samples, one every",
        "20 ms. Each column is clipped to the magnitude in brackets, as in training.",
        "",
        *(f"  observation[{k}]  {name} ({limit:g})" for k, (name, limit) in enumerate(limits)),
        "",
        *(
            f"  action[{k}]  {joint}, desired angle in rad, {low:g} to {high:g}"
            for k, (joint, low, high) in enumerate(ranges)
        ),
        "",
        *(f"from {Path(name).name}, SHA-256 {digest}" for name, digest in origin.items()),
    ]
    # no line can end the comment
    plain = (line.replace("*/", "* /").replace("\n", " ") for line in lines)
    return "\n".join(f" * {line}".rstrip() for line in plain).removesuffix("\n *")


def _constants(name: str, array: Array32) -> str:
    """An array, row by row, with enough digits to restore the same 32 bits."""
    numbers = [_number(x) for x in array.ravel()]
    lines = ",\n".join("    " + ", ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8))
    return f"static const float {name}[{array.size}] = {{\n{lines}}};"


def _number(x: np.float32) -> str:
    return np.format_float_scientific(x, trim="0") + "f"


FORMATS: Mapping[str, tuple[str, Callable[[Policy], str | bytes]]] = {
    "npz": (".npz", npz),
    "c": (".h", c_header),
    "onnx": (".onnx", onnx_model),
}
"""File name extension and writer of each format."""


def write_policy(policy: Policy, path: Path, formats: tuple[str, ...]) -> list[Path]:
    """Write a policy in several formats, to ``path`` with the extension of each."""
    files = [check_writable(path.with_suffix(FORMATS[name][0])) for name in formats]
    contents = [FORMATS[name][1](policy) for name in formats]
    return [write_whole(file, content) for file, content in zip(files, contents, strict=True)]
