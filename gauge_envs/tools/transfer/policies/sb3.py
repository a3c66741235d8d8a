"""Policies in files of Stable-Baselines3, built from their weights, so that no code of the file runs."""

import io
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import PolicyError, needs_extra
from gauge_envs.files import MEGABYTE, json_document, read_regular
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.control import Policy

MOST_BYTES = 512 * MEGABYTE
"""Largest size of a file and of its weights."""

MOST_DATA_BYTES = 16 * MEGABYTE
"""Largest size of the readable part of a file, which states classes and arguments."""

ACTORS = {
    "mlp_extractor.policy_net.": ("action_net.", "Tanh", False),
    "actor.latent_pi.": ("actor.mu.", "ReLU", True),
    "actor.mu.": (None, "ReLU", True),
}
"""Weights of the hidden layers of an actor: the weights of its last layer (None: the last of the hidden ones), the
default activation, and whether a tanh ends it. They are those of PPO and A2C; SAC; TD3 and DDPG."""

MODULES = re.compile(
    r"stable_baselines3\.(common|sac|td3)\.policies|sb3_contrib\.\w+\.policies"
)
"""Modules whose policies have these networks; a class of a user may compute something else from the same weights."""

HARMLESS = {
    "activation_fn", "features_extractor_kwargs", "log_std_init", "n_critics", "n_quantiles", "net_arch",
    "normalize_images", "optimizer_class", "optimizer_kwargs", "ortho_init", "share_features_extractor",
    "top_quantiles_to_drop_per_net", "use_sde",
}  # fmt: skip
"""Arguments of a policy that leave the deterministic action of these networks as it is, with `use_sde` false."""

ACTIVATIONS = ("Tanh", "ReLU", "ELU", "GELU", "SiLU", "LeakyReLU", "Sigmoid")


class _NotPlainError(Exception):
    """The network cannot be built from weights; the message gives the reason."""


def load_sb3(
    file: Path, *, observation_size: int, action_size: int, trust: bool = False
) -> Policy:
    """Return the deterministic policy of a file that Stable-Baselines3 saved.

    Such a file holds pickles, and loading those runs any code that its author put there. The actor of an `MlpPolicy` is
    therefore built from its weights alone, which PyTorch reads without running code. Others need `trust`.

    Args:
        file: The file.
        observation_size: Size n of the task's observation.
        action_size: Size of the task's action.
        trust: Whether to load other policies with Stable-Baselines3, which runs code of the file.
    """
    stated, weights = _parts(file)
    try:
        return _from_weights(file, stated, weights, observation_size, action_size)
    except _NotPlainError as reason:
        if not trust:
            raise PolicyError(
                f"{file}: {reason}, so it cannot be built from its weights alone. Loading it with Stable-Baselines3 "
                "runs code that the file holds: add --trust (trust=True) if you trust its author"
            ) from None
    return _with_sb3(file, stated, observation_size)


def _parts(file: Path) -> tuple[dict[str, Any], bytes]:
    """Return the readable part of a file, and its weights."""
    try:
        with zipfile.ZipFile(io.BytesIO(read_regular(file, MOST_BYTES))) as archive:
            stated = json_document(_part(archive, "data", MOST_DATA_BYTES))
            weights = _part(archive, "policy.pth", MOST_BYTES)
        if not isinstance(stated, dict):
            raise ValueError(
                f"data holds a {type(stated).__name__}, expected a JSON object"
            )
        # PyTorch unpacks the parts of an archive within the archive.
        with zipfile.ZipFile(io.BytesIO(weights)) as inner:
            if sum(entry.file_size for entry in inner.infolist()) > MOST_BYTES:
                raise ValueError(
                    f"policy.pth unpacks to more than {MOST_BYTES // MEGABYTE} MB"
                )
    except OSError as error:
        raise PolicyError(
            f"{file}: cannot be read: {error.strerror or error}"
        ) from error
    except (
        Exception
    ) as error:  # zipfile and zlib raise errors of many kinds for a damaged archive.
        raise PolicyError(
            f"{file}: it is no policy of Stable-Baselines3: {error}"
        ) from error
    return stated, weights


def _part(archive: zipfile.ZipFile, name: str, most_bytes: int) -> bytes:
    """Return a part of an archive."""
    if name not in archive.namelist():
        raise ValueError("expected the parts data and policy.pth")
    size = archive.getinfo(name).file_size
    if size > most_bytes:
        raise ValueError(
            f"{name} has {size / MEGABYTE:.6g} MB, the limit is {most_bytes / MEGABYTE:g} MB"
        )
    return archive.read(name)


def _from_weights(
    file: Path,
    stated: Mapping[str, Any],
    weights: bytes,
    observation_size: int,
    action_size: int,
) -> Policy:
    with needs_extra("a policy of Stable-Baselines3", "rl"):
        import torch
    try:
        tensors = torch.load(io.BytesIO(weights), map_location="cpu", weights_only=True)
    except Exception as error:  # PyTorch raises errors of many kinds for damaged files.
        raise PolicyError(
            f"{file}: policy.pth holds no weights: {str(error)[:200]}"
        ) from error
    if not isinstance(tensors, dict) or not all(
        isinstance(key, str) and isinstance(one, torch.Tensor)
        for key, one in tensors.items()
    ):
        raise PolicyError(f"{file}: policy.pth holds no weights")
    hidden, (last, default, squashed) = _actor(tensors)
    activation = _activation(stated, default)
    prefixes = [*_hidden_layers(tensors, hidden), *([] if last is None else [last])]
    used = [one for key, one in tensors.items() if key.startswith(tuple(prefixes))]
    # A tensor may repeat one number a billion times, which a layer would then hold.
    if sum(one.numel() * one.element_size() for one in used) > len(weights):
        raise PolicyError(f"{file}: its layers have more numbers than policy.pth holds")
    layers = [_linear(torch, tensors, prefix) for prefix in prefixes]
    sizes = [layers[0].in_features, layers[-1].out_features]
    for size, expected, what in zip(
        sizes, (observation_size, action_size), ("observation", "action"), strict=True
    ):
        if size != expected:
            raise PolicyError(
                f"{file}: the policy has {size} entries of the {what}, the task has {expected}"
            )
    modules: list[Any] = []
    for layer in layers[:-1]:
        modules += [layer, getattr(torch.nn, activation)()]
    modules += [layers[-1], torch.nn.Tanh()] if squashed else [layers[-1]]
    network = torch.nn.Sequential(*modules).eval()

    def act(observation: FloatArray) -> NDArray[np.floating]:
        with torch.no_grad():
            given = torch.as_tensor(np.asarray(observation, dtype=np.float32)).reshape(
                1, -1
            )
            return np.asarray(network(given).numpy())[0]

    return act


def _actor(tensors: Mapping[str, Any]) -> tuple[str, tuple[str | None, str, bool]]:
    """Return the prefix of the actor's hidden layers and what belongs to it."""
    for hidden, rest in ACTORS.items():
        if not any(key.startswith(hidden) for key in tensors):
            continue
        actor_prefix = hidden.partition(".")[0] + "."
        known = (
            hidden,
            *filter(None, [rest[0]]),
            "actor.log_std",
            "log_std",
            "value_net.",
            "mlp_extractor.value_net.",
        )
        extra = [
            key
            for key in tensors
            if key.startswith((actor_prefix, "features", "pi_features"))
            and not key.startswith(known)
        ]
        if extra:
            raise _NotPlainError(
                f"its actor has further weights ({', '.join(extra[:3])})"
            )
        return hidden, rest
    raise _NotPlainError("its weights are not those of an MlpPolicy with hidden layers")


def _hidden_layers(tensors: Mapping[str, Any], hidden: str) -> list[str]:
    """Return the prefixes of the hidden layers, in order."""
    names = {
        key.removeprefix(hidden).partition(".")[0]
        for key in tensors
        if key.startswith(hidden)
    }
    if not all(re.fullmatch("[0-9]{1,4}", name) for name in names):
        raise _NotPlainError(f"its layers {hidden}* are not numbered")
    return [f"{hidden}{name}." for name in sorted(names, key=int)]


def _activation(stated: Mapping[str, Any], default: str) -> str:
    """Return the activation of hidden layers, from the readable part of the file."""
    policy, kwargs = stated.get("policy_class"), stated.get("policy_kwargs", {})
    module = policy.get("__module__", "") if isinstance(policy, dict) else ""
    if not MODULES.fullmatch(str(module)):
        raise _NotPlainError(f"its class is of the module {module or 'unknown'!r}")
    if not isinstance(kwargs, dict):
        raise _NotPlainError("its policy_kwargs are not readable")
    if stated.get("use_sde") or str(kwargs.get("use_sde", False)) != "False":
        raise _NotPlainError("it explores with gSDE")
    other = sorted(
        key for key in kwargs if not key.startswith(":") and key not in HARMLESS
    )
    if other:
        raise _NotPlainError(f"its policy_kwargs hold {', '.join(other)}")
    if "activation_fn" not in kwargs:
        return default
    name = str(kwargs["activation_fn"]).rpartition(".")[2].strip("'>")
    if name not in ACTIVATIONS or "torch.nn.modules.activation" not in str(
        kwargs["activation_fn"]
    ):
        raise _NotPlainError(f"its activation is {kwargs['activation_fn']}")
    return name


def _linear(torch: Any, tensors: Mapping[str, Any], prefix: str) -> Any:
    """Return a linear layer with the weights of a prefix."""
    weight, bias = tensors.get(f"{prefix}weight"), tensors.get(f"{prefix}bias")
    if (
        weight is None
        or bias is None
        or weight.ndim != 2
        or bias.shape != weight.shape[:1]
    ):
        raise _NotPlainError(f"layer {prefix.rstrip('.')} is not linear")
    if not all(
        one.is_floating_point() and one.layout is torch.strided and not one.is_meta
        for one in (weight, bias)
    ):
        raise _NotPlainError(f"layer {prefix.rstrip('.')} holds no plain numbers")
    layer = torch.nn.Linear(weight.shape[1], weight.shape[0])
    layer.load_state_dict({"weight": weight, "bias": bias})
    return layer


def _with_sb3(file: Path, stated: Mapping[str, Any], observation_size: int) -> Policy:
    """Return the policy as Stable-Baselines3 loads it, which runs code of the file."""
    with needs_extra("a policy of Stable-Baselines3", "rl"):
        import stable_baselines3
    for name in ("PPO", "A2C", "SAC", "TD3", "DDPG"):
        try:
            model = getattr(stable_baselines3, name).load(file, device="cpu")
            break
        except Exception as error:  # The class of the algorithm is not in the file; the wrong one raises anything.
            reason = f"{type(error).__name__}: {str(error)[:120]}"
    else:
        raise PolicyError(
            f"{file}: Stable-Baselines3 cannot load it as PPO, A2C, SAC, TD3 or DDPG: {reason}"
        )
    if model.observation_space.shape != (observation_size,):
        raise PolicyError(
            f"{file}: the policy has observations of shape {model.observation_space.shape}, "
            f"the task has ({observation_size},)"
        )
    return lambda observation: model.predict(observation, deterministic=True)[0]
