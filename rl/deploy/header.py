"""A policy as one C header, for the microcontroller in the robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rl.deploy.forward import Array, Policy
from sim2real.velocity import NEWEST

_PER_LINE = 8

_TEMPLATE = """\
/* A policy that swims, made by 'sim2real export'. C99; also C++. No allocation.
 *
 * policy(observation, action): desired joint angles in rad from what was measured, 50 times a
 * second. {floats} constants of 4 bytes; {stack} bytes of stack.
{comment}
 */
#ifndef SIM2REAL_POLICY_H
#define SIM2REAL_POLICY_H

#include <math.h>

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

static void policy(const float observation[{O}], float action[{J}]) {{
{body}
}}

#endif
"""

_RELU = """\
    for (int i = 0; i < {n}; i++) {{
        {y}[i] = {y}[i] > 0.0f ? {y}[i] : 0.0f;
    }}"""

_SCALE = """\
    for (int i = 0; i < {J}; i++) {{
        const float share = (tanhf(action[i]) + 1.0f) / 2.0f;
        action[i] = policy_low_rad[i] + share * (policy_high_rad[i] - policy_low_rad[i]);
    }}"""


def c_header(policy: Policy) -> str:
    """The content of ``policy.h``: constants, and a function from observation to action."""
    arrays = {"policy_low_rad": policy.low, "policy_high_rad": policy.high}
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        arrays |= {f"policy_weight_{k}": weight, f"policy_bias_{k}": bias}
    hidden = [len(bias) for bias in policy.biases[:-1]]
    return _TEMPLATE.format(
        floats=sum(array.size for array in arrays.values()),
        stack=4 * sum(max(hidden[k::2], default=0) for k in (0, 1)),
        comment=_comment(policy),
        arrays="\n\n".join(_constants(name, array) for name, array in arrays.items()),
        body=_body(policy, hidden),
        O=len(policy.observation),
        J=len(policy.joints),
    )


def _comment(policy: Policy) -> str:
    """Order and units of what goes in and what comes out."""
    limits = zip(policy.observation, policy.observation_limit, strict=True)
    ranges = zip(policy.joints, policy.low, policy.high, strict=True)
    lines = [
        "",
        "The unit is the end of the name; ahead and left are the target's place in the body's",
        f"frame. Velocities are slopes of the line through the last {NEWEST} samples, one every",
        "20 ms. In training each column was cut to the size in brackets, so cut it too.",
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
    numbers = [np.format_float_scientific(x, trim="0") + "f" for x in array.ravel()]
    rows = [numbers[k : k + _PER_LINE] for k in range(0, len(numbers), _PER_LINE)]
    lines = ",\n".join("    " + ", ".join(row) for row in rows)
    return f"static const float {name}[{array.size}] = {{\n{lines}}};"


def _body(policy: Policy, hidden: list[int]) -> str:
    """Layer after layer, to and fro between two buffers."""
    buffers = {name: hidden[k::2] for k, name in enumerate(("even", "odd"))}
    lines = [f"    float {name}[{max(sizes)}];" for name, sizes in buffers.items() if sizes]
    x = "observation"
    for k, weight in enumerate(policy.weights):
        last = k == len(hidden)
        y = "action" if last else ("even", "odd")[k % 2]
        outputs, inputs = weight.shape
        call = f"policy_weight_{k}, policy_bias_{k}, {outputs}, {inputs}, {x}, {y}"
        lines.append(f"    policy_layer({call});")
        lines.append((_SCALE if last else _RELU).format(n=outputs, y=y, J=outputs))
        x = y
    return "\n".join(lines)
