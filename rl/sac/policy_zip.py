"""Policies as zip files without pickled objects; the same policy gives the same bytes.

Members are ``data`` (settings, JSON), ``policy.pth`` and ``pytorch_variables.pth`` (tensors by
name). Stable-Baselines3 pickles objects into ``data``, which are never unpickled: settings are
taken from the text beside them, and arrays of joint angles are the bytes in the pickles' code.
"""

import base64
import json
import os
import pickletools
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from rl.deploy.policy import LARGEST_BYTES
from sim2real.errors import InputError, shown
from sim2real.output import finite_json, write_whole
from sim2real.structured import Fields, read_members, reason

SCHEMA = "sim2real.policy_zip/1"
_MEMBERS = re.compile(
    r"data|policy\.pth|(pytorch_variables|tensors)\.pth|([a-z_]+[._])?optimizer\.pth"
    r"|_stable_baselines3_version|system_info\.txt"
)
_ALGORITHMS = {
    "stable_baselines3.sac.policies": "SAC",
    "rl.sac.sac": "SAC",
    "stable_baselines3.dqn.policies": "DQN",
}
"""Algorithm by the module of the class of a policy."""
_HARMLESS = {
    "net_arch", "n_critics", "use_sde", "activation_fn", "log_std_init", "optimizer_class",
    "optimizer_kwargs", "share_features_extractor", "normalize_images", ":type:", ":serialized:",
}  # fmt: skip
"""Options of Stable-Baselines3's policies that the weights show or that a saved policy ignores."""
_RELU = "torch.nn.modules.activation.ReLU"


@dataclass(frozen=True)
class PolicyZip:
    """The content of a file."""

    settings: Fields  # JSON values by name
    weights: Mapping[str, Tensor]  # tensors of the networks by name, finite and of float32
    variables: Mapping[str, Tensor]  # further tensors by name, likewise

    def widths(self, layers: str, output: str | None = None) -> list[int]:
        """Number of inputs of a network, then of outputs of each of its linear layers."""
        numbered = re.compile(re.escape(layers) + r"\.(\d+)\.weight")
        found = {int(m[1]): name for name in self.weights if (m := numbered.fullmatch(name))}
        names = [found[k] for k in sorted(found)] + [f"{output}.weight"] * (output is not None)
        shapes = [tuple(self.weights[name].shape) for name in names if name in self.weights]
        if not shapes or any(len(shape) != 2 for shape in shapes):
            found_shapes = f"weights of the shapes {shapes}" if shapes else "no weights"
            raise InputError(self.settings.file, layers, found_shapes, "a fully connected network")
        return [shapes[0][1], *(shape[0] for shape in shapes)]


def load_weights(
    path: str | os.PathLike[str],
    policy: nn.Module,
    weights: Mapping[str, Any],
    expected: str = "those of an MlpPolicy",
) -> None:
    """Copy the weights of the file ``path`` to a policy; ``InputError`` for other networks."""
    try:
        policy.load_state_dict(dict(weights))
    except RuntimeError as error:
        problem = str(error).splitlines()[-1].strip()
        raise InputError(path, "networks", problem, expected) from None


def write_policy_zip(
    path: str | os.PathLike[str],
    policy: nn.Module,
    settings: Mapping[str, Any],
    variables: Mapping[str, Tensor],
) -> None:
    """Write ``policy.zip`` atomically; see ``PolicyZip``."""
    content = json.dumps(finite_json({"schema": SCHEMA, **settings}), indent=2, allow_nan=False)
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        for name, data in (
            ("data", content.encode()),
            ("policy.pth", _saved(policy.state_dict())),
            ("pytorch_variables.pth", _saved(variables)),
        ):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.create_system, entry.external_attr = 3, 0o600 << 16
            file.writestr(entry, data)
    write_whole(path, archive.getvalue())


def _saved(tensors: Mapping[str, Tensor]) -> bytes:
    """Tensors as ``torch.save`` writes them; copies, as a view would be written with its base."""
    stream = BytesIO()
    torch.save({k: v.detach().cpu().clone() for k, v in tensors.items()}, stream)
    return stream.getvalue()


def read_policy_zip(path: str | os.PathLike[str], algorithm: str) -> PolicyZip:
    """Read a policy of this library or Stable-Baselines3; nothing in it is executed."""
    file, expected = Path(path), f"a policy saved by Stable-Baselines3's {algorithm}"
    members = _members(file, expected)
    settings = _settings(file, members["data"], expected)
    if settings.get("algorithm") != algorithm:
        raise InputError(file, "algorithm", shown(settings.get("algorithm")), algorithm)
    tensors = [
        _tensors(file, name, members[name]) if name in members else {}
        for name in ("policy.pth", "pytorch_variables.pth")
    ]
    return PolicyZip(Fields(file, "", settings), *tensors)


def read_settings(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The settings of a policy; errors as of ``read_policy_zip``."""
    expected = "a policy.zip"
    return _settings(Path(path), _members(Path(path), expected)["data"], expected)


def _members(file: Path, expected: str) -> dict[str, bytes]:
    members = {}
    for name, content in read_members(file, expected, what="policy", largest=LARGEST_BYTES):
        if not _MEMBERS.fullmatch(name):
            raise InputError(file, "", f"a member {shown(name)}", expected)
        members[name] = content
    if not members.keys() >= {"data", "policy.pth"}:
        raise InputError(file, "", f"members {', '.join(members) or 'none'}", expected)
    return members


def _tensors(file: Path, name: str, content: bytes) -> dict[str, Tensor]:
    """Tensors by name, as ``torch.save`` writes them."""
    try:
        with zipfile.ZipFile(BytesIO(content)) as inner:
            if sum(entry.file_size for entry in inner.infolist()) > len(content):
                raise ValueError("tensors that are compressed")
        loaded = torch.load(BytesIO(content), map_location="cpu", weights_only=True)
        tensors = dict(loaded)
        for key, tensor in tensors.items():
            plain = type(tensor) is Tensor and tensor.layout == torch.strided
            if not plain or tensor.dtype != torch.float32:
                raise ValueError(f"{key!r}, no tensor of float32")
        if 4 * sum(tensor.numel() for tensor in tensors.values()) > len(content):
            raise ValueError("tensors larger than their numbers")
        for key, tensor in tensors.items():
            if not bool(torch.isfinite(tensor).all()):
                raise ValueError(f"{key!r}, not finite")
    except Exception as error:  # damaged files raise exceptions of many kinds
        raise InputError(file, name, reason(error), "tensors by torch.save") from None
    return {key: tensor.detach() for key, tensor in tensors.items()}


def _settings(file: Path, content: bytes, expected: str) -> dict[str, Any]:
    try:
        settings = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(file, "data", f"no JSON ({reason(error)})", expected) from None
    if not isinstance(settings, dict):
        raise InputError(file, "data", f"a JSON {type(settings).__name__}", expected)
    if "schema" not in settings:
        return _of_stable_baselines3(file, settings, expected)
    if settings["schema"] != SCHEMA:
        raise InputError(file, "schema", shown(settings["schema"]), repr(SCHEMA))
    return settings


def _of_stable_baselines3(file: Path, data: Mapping[str, Any], expected: str) -> dict[str, Any]:
    """The settings in the JSON of Stable-Baselines3, without its pickled objects."""
    module = _object(data.get("policy_class")).get("__module__")
    if not isinstance(module, str) or module not in _ALGORITHMS:
        raise InputError(file, "policy_class", f"a class of {shown(module)}", expected)
    options = _object(data.get("policy_kwargs"))
    if data.get("use_sde"):
        raise InputError(file, "policy", "state-dependent exploration", "a policy without")
    if _RELU not in str(options.get("activation_fn", _RELU)):
        relu = "fully connected layers with ReLU between them"
        raise InputError(file, "policy", f"layers {shown(options['activation_fn'])}", relu)
    if unknown := options.keys() - _HARMLESS:
        raise InputError(file, "policy_kwargs", shown(min(unknown)), "an MlpPolicy")
    settings = {k: v for k, v in data.items() if k in ("joints", "trained_over", "num_timesteps")}
    settings |= {k: data[k] for k in ("gaits",) if k in data}
    box = _object(data.get("action_space"))
    settings |= {f"action_{end}": _printed(box.get(end)) for end in ("low", "high") if end in box}
    settings |= {k: _bytes(data[k]) for k in ("joint_low", "joint_high") if k in data}
    if view := _object(data.get("view")):
        settings["view"] = {k: v for k, v in view.items() if not k.startswith(":")}
    if price := _object(data.get("by_price")):
        column = _bytes(price) if price.get("column") is not None else None
        settings["by_price"] = {k: price.get(k) for k in ("prices", "share")} | {"column": column}
    return {"algorithm": _ALGORITHMS[module], **settings}


def _object(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _printed(text: object) -> list[float] | None:
    """The numbers of an array printed as text; None if it is anything else."""
    try:
        return [float(x) for x in str(text).strip("[]").split()]
    except ValueError:
        return None


def _bytes(value: object) -> list[float] | None:
    """The numbers of the first array of float32 in a pickled value, which is not unpickled."""
    try:
        content = base64.b64decode(_object(value).get(":serialized:", ""), validate=True)
        operations = [(code.name, given) for code, given, _ in pickletools.genops(content)]
    except Exception:  # damaged ones raise exceptions of many kinds
        return None
    buffers: list[Any] = [given for name, given in operations if name == "BYTEARRAY8"]
    texts = {given for _, given in operations if isinstance(given, str)}
    if not buffers or len(buffers[0]) % 4 or not {"_frombuffer", "f4", "<"} <= texts:
        return None
    return [float(x) for x in np.frombuffer(buffers[0], "<f4")]
