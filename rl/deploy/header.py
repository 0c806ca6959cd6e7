"""Export of a policy as a C header, for a microcontroller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rl import observer
from rl.deploy.policy import Policy
from sim2real.arrays import Array32
from sim2real.velocity import NEWEST

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
