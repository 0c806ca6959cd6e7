"""Export of a policy as a C header, for a microcontroller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rl import observer
from rl.deploy.forward import Policy
from sim2real.arrays import Array32
from sim2real.velocity import NEWEST

_PER_LINE = 8

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

/* Linear layer: y = W x + b. */
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

static float policy_clip(float x, float limit) {{
    return x > limit ? limit : x < -limit ? -limit : x;
}}

static float policy_bearing(const float observation[{O}]) {{
    return atan2f(policy_clip(observation[{O} - 1], policy_limit[{O} - 1]),
                  policy_clip(observation[{O} - 2], policy_limit[{O} - 2]));
}}

static void policy_begin(policy_memory *memory, const float observation[{O}]) {{
    for (int j = 0; j < {J}; j++) {{
        const float span = policy_high_rad[j] - policy_low_rad[j];
        const float angle = policy_clip(observation[3 + j], policy_limit[3 + j]);
        for (int k = 0; k < {K}; k++) {{
            memory->decisions[k][j] =
                policy_clip(2.0f * (angle - policy_low_rad[j]) / span - 1.0f, 1.0f);
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
{columns}
    (void)n;
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
{set_point}
        action[j] = policy_low_rad[j]
            + (current + 1.0f) / 2.0f * (policy_high_rad[j] - policy_low_rad[j]);
    }}
}}

#endif
"""

_SCALED = """\
    const float ahead = clipped[{O} - 2], left = clipped[{O} - 1];
    const float distance = sqrtf(ahead * ahead + left * left);
    inputs[n++] = clipped[0] / {surge};
    inputs[n++] = clipped[1] / {sway};
    inputs[n++] = clipped[2] / {yaw};
    for (int j = 0; j < {J}; j++) {{
        const float span = policy_high_rad[j] - policy_low_rad[j];
        inputs[n++] = 2.0f * (clipped[3 + j] - policy_low_rad[j]) / span - 1.0f;
    }}
    for (int j = 0; j < {J}; j++) {{
        inputs[n++] = clipped[3 + {J} + j] / {rate};
    }}
    inputs[n++] = sinf(bearing);
    inputs[n++] = cosf(bearing);
    inputs[n++] = logf((distance + {near}) / {half});
    for (int i = 0; i < n; i++) {{
        inputs[i] = policy_clip(inputs[i], {largest});
    }}"""

_PLAIN = """\
    for (; n < {O}; n++) {{
        inputs[n] = clipped[n];
    }}"""

_SIDES = """\
    inputs[n++] = bearing / {pi};
    inputs[n++] = memory->side;"""

_MEMORY = """\
    for (int k = 0; k < {memory}; k++) {{
        for (int j = 0; j < {J}; j++) {{
            inputs[n++] = memory->decisions[k][j];
        }}
    }}"""

_LINE = """\
        const float before = memory->decisions[1][j];
        const float share = (float)(memory->since + 1) / (float)POLICY_PERIOD;
        const float current = before + (memory->decisions[0][j] - before) * share;"""

_AT_ONCE = """\
        const float current = memory->decisions[0][j];"""

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
        "surge": observer.SURGE_M_S, "sway": observer.SWAY_M_S, "yaw": observer.YAW_RAD_S,
        "rate": observer.RATE_RAD_S, "near": observer.NEAR_M, "half": observer.HALF_M,
        "largest": observer.LARGEST, "kept": observer.KEPT_RAD, "stroke": observer.STROKE,
        "turn": 2 * np.pi, "pi": np.pi,
    }  # fmt: skip
    literals = {name: _number(np.float32(value)) for name, value in numbers.items()}
    parts = [_SCALED if view.scaled else _PLAIN]
    parts += [_SIDES] * view.sides + [_MEMORY] * (view.memory > 0)
    columns = "\n".join(parts).format(O=O, J=J, memory=view.memory, **literals)
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
        **literals,
    )


def _comment(policy: Policy) -> str:
    """Order and units of observation and action."""
    limits = zip(policy.observation, policy.observation_limit, strict=True)
    ranges = zip(policy.joints, policy.low, policy.high, strict=True)
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
        *(f"from {_plain(name)}, SHA-256 {digest}" for name, digest in _inputs(policy)),
    ]
    return "\n".join(f" * {_plain(line)}".rstrip() for line in lines).removesuffix("\n *")


def _inputs(policy: Policy) -> list[tuple[str, str]]:
    inputs = dict(policy.provenance.get("inputs", {}))
    return [(Path(name).name, str(digest)) for name, digest in inputs.items()]


def _plain(text: str) -> str:
    """Text that cannot end a comment."""
    return text.replace("*/", "* /").replace("\n", " ")


def _constants(name: str, array: Array32) -> str:
    """An array, row by row, with enough digits to restore the same 32 bits."""
    numbers = [_number(x) for x in array.ravel()]
    rows = [numbers[k : k + _PER_LINE] for k in range(0, len(numbers), _PER_LINE)]
    lines = ",\n".join("    " + ", ".join(row) for row in rows)
    return f"static const float {name}[{array.size}] = {{\n{lines}}};"


def _number(x: np.float32) -> str:
    return np.format_float_scientific(x, trim="0") + "f"


def _body(policy: Policy, hidden: list[int]) -> str:
    """Calls of all layers, alternating between two buffers."""
    buffers = {name: hidden[k::2] for k, name in enumerate(("even", "odd"))}
    lines = [f"    float {name}[{max(sizes)}];" for name, sizes in buffers.items() if sizes]
    x = "inputs"
    for k, weight in enumerate(policy.weights):
        is_output = k == len(hidden)
        y = "action" if is_output else ("even", "odd")[k % 2]
        outputs, inputs = weight.shape
        call = f"policy_weight_{k}, policy_bias_{k}, {outputs}, {inputs}, {x}, {y}"
        lines.append(f"    policy_layer({call});")
        lines.append((_SQUASH if is_output else _RELU).format(n=outputs, y=y, J=outputs))
        x = y
    return "\n".join(lines)
