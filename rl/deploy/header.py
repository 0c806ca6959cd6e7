"""A policy as one C header, for the microcontroller in the robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rl.deploy.forward import Array, Policy
from rl.observer import (
    HALF_M,
    KEPT_RAD,
    LARGEST,
    NEAR_M,
    RATE_RAD_S,
    STROKE,
    SURGE_M_S,
    SWAY_M_S,
    YAW_RAD_S,
)
from sim2real.velocity import NEWEST

_PER_LINE = 8

_TEMPLATE = """\
/* A policy that swims, made by 'sim2real export'. C99; also C++. No allocation.
 *
 * policy_begin(&memory, observation), once at the start; then, 50 times a second,
 * policy(&memory, 1, observation, action): desired joint angles in rad from what was measured.
 * The second argument is the number of control periods of 20 ms since the last call, more than
 * one where a measurement was lost. {floats} constants of 4 bytes; {stack} bytes of stack.
{comment}
 */
#ifndef SIM2REAL_POLICY_H
#define SIM2REAL_POLICY_H

#include <math.h>

#define POLICY_PERIOD {period}

/* What is remembered: decisions between -1 and 1, the newest first; the bearing; the side of the
 * last stroke; control periods since the last decision, -1 before the first. */
typedef struct {{
    float given[{K}][{J}], bearing, side;
    int since;
}} policy_memory;

{arrays}

/* Sums of the inputs, weighted, and a bias: y = W x + b. */
static void policy_layer(const float *weight, const float *bias, int outputs, int inputs,
                         const float *x, float *y) {{
    for (int i = 0; i < outputs; i++) {{
        float sum = bias[i];
        for (int j = 0; j < inputs; j++) {{
            sum += weight[i * inputs + j] * x[j];
        }}
        y[i] = sum;
    }}
}}

static void policy_network(const float inputs[{F}], float action[{J}]) {{
{body}
}}

static float policy_cut(float x, float most) {{
    return x > most ? most : x < -most ? -most : x;
}}

static float policy_bearing(const float observation[{O}]) {{
    return atan2f(policy_cut(observation[{O} - 1], policy_limit[{O} - 1]),
                  policy_cut(observation[{O} - 2], policy_limit[{O} - 2]));
}}

static void policy_begin(policy_memory *memory, const float observation[{O}]) {{
    for (int j = 0; j < {J}; j++) {{
        const float span = policy_high_rad[j] - policy_low_rad[j];
        const float angle = policy_cut(observation[3 + j], policy_limit[3 + j]);
        for (int k = 0; k < {K}; k++) {{
            memory->given[k][j] =
                policy_cut(2.0f * (angle - policy_low_rad[j]) / span - 1.0f, 1.0f);
        }}
    }}
    memory->bearing = policy_bearing(observation);
    memory->side = memory->bearing < 0.0f ? -1.0f : 1.0f;
    memory->since = -1;
}}

/* The policy's {F} inputs; the bearing keeps its side until the target has gone far round. */
static void policy_see(policy_memory *memory, const float observation[{O}], float inputs[{F}]) {{
    float seen[{O}], bearing = policy_bearing(observation);
    int n = 0;
    for (int i = 0; i < {O}; i++) {{
        seen[i] = policy_cut(observation[i], policy_limit[i]);
    }}
    const float other = bearing > 0.0f ? bearing - {turn} : bearing + {turn};
    if (bearing * memory->bearing < 0.0f && fabsf(other) <= {kept}) {{
        bearing = other;
    }}
    memory->bearing = bearing;
{columns}
    (void)n;
}}

static void policy_decide(policy_memory *memory, const float observation[{O}]) {{
    float inputs[{F}], decision[{J}], mean = 0.0f;
    policy_see(memory, observation, inputs);
    policy_network(inputs, decision);
    for (int j = 0; j < {J}; j++) {{
        mean += decision[j] / {J}.0f;
        for (int k = {K} - 1; k > 0; k--) {{
            memory->given[k][j] = memory->given[k - 1][j];
        }}
        memory->given[0][j] = decision[j];
    }}
    if (fabsf(mean) > {stroke}) {{
        memory->side = mean > 0.0f ? 1.0f : -1.0f;
    }}
}}

static void policy(policy_memory *memory, int gone, const float observation[{O}],
                   float action[{J}]) {{
    int due = memory->since < 0;
    memory->since = due ? 0 : memory->since + gone;
    due = due || memory->since >= POLICY_PERIOD;
    memory->since %= POLICY_PERIOD;
    if (due) {{
        policy_decide(memory, observation);
    }}
    for (int j = 0; j < {J}; j++) {{
{set_point}
        action[j] = policy_low_rad[j]
            + (now + 1.0f) / 2.0f * (policy_high_rad[j] - policy_low_rad[j]);
    }}
}}

#endif
"""

_SCALED = """\
    const float distance = sqrtf(seen[{O} - 2] * seen[{O} - 2] + seen[{O} - 1] * seen[{O} - 1]);
    inputs[n++] = seen[0] / {surge};
    inputs[n++] = seen[1] / {sway};
    inputs[n++] = seen[2] / {yaw};
    for (int j = 0; j < {J}; j++) {{
        const float span = policy_high_rad[j] - policy_low_rad[j];
        inputs[n++] = 2.0f * (seen[3 + j] - policy_low_rad[j]) / span - 1.0f;
    }}
    for (int j = 0; j < {J}; j++) {{
        inputs[n++] = seen[3 + {J} + j] / {rate};
    }}
    inputs[n++] = sinf(bearing);
    inputs[n++] = cosf(bearing);
    inputs[n++] = logf((distance + {near}) / {half});
    for (int i = 0; i < n; i++) {{
        inputs[i] = policy_cut(inputs[i], {largest});
    }}"""

_PLAIN = """\
    for (; n < {O}; n++) {{
        inputs[n] = seen[n];
    }}"""

_SIDES = """\
    inputs[n++] = bearing / {pi};
    inputs[n++] = memory->side;"""

_MEMORY = """\
    for (int k = 0; k < {memory}; k++) {{
        for (int j = 0; j < {J}; j++) {{
            inputs[n++] = memory->given[k][j];
        }}
    }}"""

_LINE = """\
        const float before = memory->given[1][j];
        const float share = (float)(memory->since + 1) / (float)POLICY_PERIOD;
        const float now = before + (memory->given[0][j] - before) * share;"""

_AT_ONCE = """\
        const float now = memory->given[0][j];"""

_RELU = """\
    for (int i = 0; i < {n}; i++) {{
        {y}[i] = {y}[i] > 0.0f ? {y}[i] : 0.0f;
    }}"""

_SQUASH = """\
    for (int i = 0; i < {J}; i++) {{
        action[i] = tanhf(action[i]);
    }}"""


def c_header(policy: Policy) -> str:
    """The content of ``policy.h``: constants, and a function from observation to action."""
    arrays = {"policy_low_rad": policy.low, "policy_high_rad": policy.high}
    arrays["policy_limit"] = policy.observation_limit
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        arrays |= {f"policy_weight_{k}": weight, f"policy_bias_{k}": bias}
    hidden = [len(bias) for bias in policy.biases[:-1]]
    view, O, J = policy.view, len(policy.observation), len(policy.joints)  # noqa: E741
    F = view.size(J)
    numbers = {
        "surge": SURGE_M_S, "sway": SWAY_M_S, "yaw": YAW_RAD_S, "rate": RATE_RAD_S,
        "near": NEAR_M, "half": HALF_M, "largest": LARGEST, "turn": 2 * np.pi, "kept": KEPT_RAD,
        "pi": np.pi, "stroke": STROKE,
    }  # fmt: skip
    told = {name: _number(np.float32(value)) for name, value in numbers.items()}
    parts = [_SCALED if view.scaled else _PLAIN]
    parts += [_SIDES] * view.sides + [_MEMORY] * (view.memory > 0)
    columns = "\n".join(parts).format(O=O, J=J, memory=view.memory, **told)
    return _TEMPLATE.format(
        floats=sum(array.size for array in arrays.values()),
        stack=4 * (sum(max(hidden[k::2], default=0) for k in (0, 1)) + F + O + 2 * J),
        comment=_comment(policy),
        arrays="\n\n".join(_constants(name, array) for name, array in arrays.items()),
        body=_body(policy, hidden),
        columns=columns,
        set_point=(_LINE if view.ramp else _AT_ONCE),
        period=view.period,
        K=max(view.memory, 2),
        O=O,
        F=F,
        J=J,
        **told,
    )


def _comment(policy: Policy) -> str:
    """Order and units of what goes in and what comes out."""
    limits = zip(policy.observation, policy.observation_limit, strict=True)
    ranges = zip(policy.joints, policy.low, policy.high, strict=True)
    lines = [
        "",
        "The unit is the end of the name; ahead and left are the target's place in the body's",
        f"frame. Velocities are slopes of the line through the last {NEWEST} samples, one every",
        "20 ms. Each column is cut to the size in brackets, as it was in training.",
        "",
        *(f"  observation[{k}]  {name} ({limit:g})" for k, (name, limit) in enumerate(limits)),
        "",
        *(
            f"  action[{k}]  {joint}, desired angle in rad, {low:g} to {high:g}"
            for k, (joint, low, high) in enumerate(ranges)
        ),
        "",
        *(f"from {_plain(name)}, SHA-256 {digest}" for name, digest in _inputs(policy)),
    ]
    return "\n".join(f" * {_plain(line)}".rstrip() for line in lines).removesuffix("\n *")


def _inputs(policy: Policy) -> list[tuple[str, str]]:
    inputs = dict(policy.provenance.get("inputs", {}))
    return [(Path(name).name, str(digest)) for name, digest in inputs.items()]


def _plain(text: str) -> str:
    """Text that cannot end a comment."""
    return text.replace("*/", "* /").replace("\n", " ")


def _constants(name: str, array: Array) -> str:
    """An array, row by row, in digits that give back the same 32 bits."""
    numbers = [_number(x) for x in array.ravel()]
    rows = [numbers[k : k + _PER_LINE] for k in range(0, len(numbers), _PER_LINE)]
    lines = ",\n".join("    " + ", ".join(row) for row in rows)
    return f"static const float {name}[{array.size}] = {{\n{lines}}};"


def _number(x: np.float32) -> str:
    return np.format_float_scientific(x, trim="0") + "f"


def _body(policy: Policy, hidden: list[int]) -> str:
    """Layer after layer, to and fro between two buffers."""
    buffers = {name: hidden[k::2] for k, name in enumerate(("even", "odd"))}
    lines = [f"    float {name}[{max(sizes)}];" for name, sizes in buffers.items() if sizes]
    x = "inputs"
    for k, weight in enumerate(policy.weights):
        last = k == len(hidden)
        y = "action" if last else ("even", "odd")[k % 2]
        outputs, inputs = weight.shape
        call = f"policy_weight_{k}, policy_bias_{k}, {outputs}, {inputs}, {x}, {y}"
        lines.append(f"    policy_layer({call});")
        lines.append((_SQUASH if last else _RELU).format(n=outputs, y=y, J=outputs))
        x = y
    return "\n".join(lines)
