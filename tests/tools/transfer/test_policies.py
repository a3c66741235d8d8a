"""Policies of other packages: they act as in the package that saved them, and loading them runs no code."""

import io
import json
import pickle
import sys
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from gymnasium.spaces import Box

from gauge_envs.errors import PolicyError
from gauge_envs.tools.transfer.policies.load import (
    checked_policy,
    load_policies,
    load_policy,
)
from gauge_envs.tools.transfer.policy_replays import make_control_env

TASK = "Pendulum-Limit-metal"


@pytest.fixture(scope="module")
def env():
    return make_control_env(TASK)


def observations():
    return 3.0 * np.random.default_rng(0).normal(size=(40, 5))


class Evil:
    """Object whose unpickling writes a file."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return (Path.touch, (self.file,))


def refused(reason, source, env, **options):
    """Assert that a policy is an error with this reason."""
    with pytest.raises(PolicyError, match=reason):
        load_policy(str(source), env, **options)


# --- Stable-Baselines3 ---


@pytest.mark.parametrize(
    ("name", "kwargs"),
    [
        ("PPO", {"net_arch": [8, 8], "activation_fn": "ReLU"}),
        ("A2C", {"net_arch": [8]}),
        ("SAC", {"net_arch": [8]}),
        ("TD3", {"net_arch": [8, 8]}),
    ],
)
def test_an_actor_from_weights_acts_as_the_package_that_saved_it(
    name, kwargs, env, tmp_path
):
    sb3 = pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    torch = pytest.importorskip("torch")
    if "activation_fn" in kwargs:
        kwargs = kwargs | {"activation_fn": getattr(torch.nn, kwargs["activation_fn"])}
    model = getattr(sb3, name)(
        "MlpPolicy", env, policy_kwargs=kwargs, device="cpu", seed=1
    )
    file = tmp_path / "policy.zip"
    model.save(file)
    policy = load_policy(str(file), env)
    for observation in observations():
        expected = model.predict(observation, deterministic=True)[0]
        # SAC and TD3 scale their action to the space and round once more.
        assert policy(observation) == pytest.approx(expected, abs=1e-7)


def test_a_network_that_weights_do_not_state_needs_trust(env, tmp_path):
    sb3 = pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    model = sb3.PPO(
        "MlpPolicy",
        env,
        policy_kwargs={"squash_output": True},
        use_sde=True,
        device="cpu",
    )
    file = tmp_path / "policy.zip"
    model.save(file)
    refused(r"gSDE.*runs code.*--trust", file, env)
    trusted = load_policy(str(file), env, trust=True)
    observation = observations()[0]
    assert trusted(observation) == pytest.approx(
        model.predict(observation, deterministic=True)[0]
    )


def write_sb3(file, sizes, *, evil=None, **data):
    torch = pytest.importorskip("torch")
    weights = {}
    for number, (before, after) in enumerate(pairwise(sizes)):
        name = (
            "action_net."
            if number == len(sizes) - 2
            else f"mlp_extractor.policy_net.{2 * number}."
        )
        weights |= {
            f"{name}weight": torch.ones(after, before),
            f"{name}bias": torch.zeros(after),
        }
    stream = io.BytesIO()
    torch.save(weights if evil is None else {"weight": Evil(evil)}, stream)
    stated = {
        "policy_class": {"__module__": "stable_baselines3.common.policies"},
        "policy_kwargs": {},
    } | data
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", json.dumps(stated))
        archive.writestr("policy.pth", stream.getvalue())
    return file


def test_a_policy_of_another_task_is_refused(env, tmp_path):
    refused(
        "7 entries of the observation, the task has 5",
        write_sb3(tmp_path / "a.zip", (7, 4, 1)),
        env,
    )
    refused(
        "2 entries of the action, the task has 1",
        write_sb3(tmp_path / "b.zip", (5, 4, 2)),
        env,
    )


def test_weights_that_hold_code_are_refused_and_do_not_run(env, tmp_path):
    mark = tmp_path / "ran"
    refused(
        "holds no weights", write_sb3(tmp_path / "a.zip", (5, 4, 1), evil=mark), env
    )
    assert not mark.exists()


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ({"policy_class": {"__module__": "mine"}}, "module 'mine'"),
        (
            {"policy_kwargs": {"features_extractor_class": "<class 'mine.Net'>"}},
            "features_extractor_class",
        ),
        (
            {"policy_kwargs": {"activation_fn": "<class 'mine.Swish'>"}},
            "activation is <class 'mine.Swish'>",
        ),
        ({"use_sde": True}, "gSDE"),
    ],
)
def test_what_may_change_the_network_needs_trust(data, reason, env, tmp_path):
    refused(f"{reason}.*--trust", write_sb3(tmp_path / "a.zip", (5, 4, 1), **data), env)


@pytest.mark.parametrize(
    "data", [b"[]", b"null", b"[" * 9000, b"\xff", b" " * 17_000_000]
)
def test_damaged_data_is_no_policy(data, env, tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data", data)
        archive.writestr("policy.pth", b"PK")
    refused(r"a\.zip: it is no policy of Stable-Baselines3", tmp_path / "a.zip", env)


def test_weights_that_unpack_to_gigabytes_are_refused(env, tmp_path):
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data/0", b"a" * 1000)
    # The size that the directory states, twice in 4 bytes.
    lied = inner.getvalue().replace(
        (1000).to_bytes(4, "little"), (10**9).to_bytes(4, "little")
    )
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("data", "{}")
        archive.writestr("policy.pth", lied)
    refused(r"policy\.pth unpacks to more than 512 MB", tmp_path / "a.zip", env)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda torch: {1: torch.ones(1)}, "holds no weights"),
        (
            lambda torch: {"mlp_extractor.policy_net.abc.weight": torch.ones(4, 5)},
            "are not numbered",
        ),
        (
            lambda torch: {"action_net.weight": torch.ones(1, 4).to_sparse()},
            "holds no plain numbers",
        ),
        (
            lambda torch: {"action_net.weight": torch.ones(1, 4, device="meta")},
            "holds no plain numbers",
        ),
        (
            lambda torch: {
                "mlp_extractor.policy_net.2.weight": torch.ones(1).expand(10**5, 10**5)
            },
            "more numbers than policy.pth holds",
        ),
    ],
)
def test_damaged_weights_are_refused(change, reason, env, tmp_path):
    torch = pytest.importorskip("torch")
    file = write_sb3(tmp_path / "a.zip", (5, 4, 1))
    with zipfile.ZipFile(file) as archive:
        data, weights = (
            archive.read("data"),
            torch.load(io.BytesIO(archive.read("policy.pth"))),
        )
    stream = io.BytesIO()
    torch.save(weights | change(torch), stream)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", data)
        archive.writestr("policy.pth", stream.getvalue())
    refused(reason, file, env)


# --- statistics ---


class VecNormalize:
    """Stand-in of the class in files of `VecNormalize.save`."""

    observation_space = Box(-np.inf, np.inf, (5,))

    def normalize_obs(self, observation):
        return 0.5 * observation


@pytest.fixture
def has_sb3(monkeypatch):
    monkeypatch.setattr(
        "gauge_envs.tools.transfer.policies.load.find_spec", lambda _: True
    )


def write_statistics(file, saved):
    file.write_bytes(pickle.dumps(saved))
    return file


def test_observations_are_normalized_as_in_the_training(env, tmp_path):
    vec = pytest.importorskip(
        "stable_baselines3.common.vec_env", reason="extra 'rl' is not installed"
    )
    scaled = vec.VecNormalize(
        vec.DummyVecEnv([lambda: make_control_env(TASK)]), clip_obs=2.0
    )
    scaled.obs_rms.update(observations())
    file = tmp_path / "norm.pkl"
    scaled.save(str(file))
    policy = load_policy("numpy:mean", env, normalization=file, trust=True)
    for observation in observations():
        assert policy(observation) == np.clip(
            scaled.normalize_obs(observation).mean(), -1.0, 1.0
        )


@pytest.mark.usefixtures("has_sb3")
def test_a_policy_gets_the_normalized_observation(env, tmp_path):
    file = write_statistics(tmp_path / "norm.pkl", VecNormalize())
    assert (
        load_policy("numpy:mean", env, normalization=file, trust=True)(np.full(5, 0.5))
        == 0.25
    )


def test_statistics_need_trust_and_run_nothing_without_it(env, tmp_path):
    mark = tmp_path / "ran"
    file = write_statistics(tmp_path / "norm.pkl", Evil(mark))
    onnx = str(write_onnx(tmp_path / "a.onnx", 5))
    refused(r"is a pickle.*--trust", onnx, env, normalization=file)
    assert not mark.exists()


@pytest.mark.usefixtures("has_sb3")
def test_statistics_of_another_task_are_refused(env, tmp_path):
    saved = VecNormalize()
    saved.observation_space = Box(-np.inf, np.inf, (3,))
    refused(
        r"shape \(3,\), the task has \(5,\)",
        "numpy:mean",
        env,
        normalization=write_statistics(tmp_path / "a.pkl", saved),
        trust=True,
    )
    refused(
        r"b\.pkl: expected a file of VecNormalize\.save",
        "numpy:mean",
        env,
        normalization=write_statistics(tmp_path / "b.pkl", {}),
        trust=True,
    )


# --- ONNX ---


def save_network(graph, file):
    onnx = pytest.importorskip("onnx")
    opset = onnx.helper.make_opsetid("", 17)
    onnx.save(onnx.helper.make_model(graph, opset_imports=[opset], ir_version=8), file)


def write_onnx(file, size, *, outputs=1):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime", reason="extra 'onnx' is not installed")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    weights = helper.make_tensor(
        "w", kind, [size, outputs], np.full(size * outputs, 0.1).tolist()
    )
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "w"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", kind, ["batch", size])],
        [helper.make_tensor_value_info("action", kind, ["batch", outputs])],
        [weights],
    )
    save_network(graph, file)
    return file


def test_an_onnx_policy_acts_as_its_network_and_is_clipped(env, tmp_path):
    policy = load_policy(str(write_onnx(tmp_path / "a.onnx", 5)), env)
    for observation in observations():
        expected = np.clip(0.1 * observation.sum(), -1.0, 1.0)
        assert policy(observation) == pytest.approx(expected, abs=1e-6)
    refused("observation has 5 entries", write_onnx(tmp_path / "b.onnx", 6), env)
    refused(
        r"action has shape \(3,\), the task takes \(1,\)",
        write_onnx(tmp_path / "c.onnx", 5, outputs=3),
        env,
    )


def test_an_onnx_file_is_run_within_limits_first(env, tmp_path, monkeypatch):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime", reason="extra 'onnx' is not installed")
    helper, kinds = onnx.helper, onnx.TensorProto
    size = helper.make_tensor("size", kinds.INT64, [2], [10**5, 10**5])
    graph = helper.make_graph(
        [
            helper.make_node("ConstantOfShape", ["size"], ["big"]),
            helper.make_node("ReduceSum", ["big"], ["sum"]),
            helper.make_node("Add", ["observation", "sum"], ["action"]),
        ],
        "policy",
        [helper.make_tensor_value_info("observation", kinds.FLOAT, ["batch", 5])],
        [helper.make_tensor_value_info("action", kinds.FLOAT, ["batch", 5])],
        [size],
    )
    file = tmp_path / "bomb.onnx"
    save_network(graph, file)
    refused(r"bomb\.onnx: onnxruntime cannot run the network", file, env)
    # A network that is cheap for zeros and a loop without end for the task's own observations.
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["on"]),
            helper.make_node("Identity", ["before"], ["after"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("step", kinds.INT64, []),
            helper.make_tensor_value_info("go", kinds.BOOL, []),
            helper.make_tensor_value_info("before", kinds.FLOAT, ["batch", 5]),
        ],
        [
            helper.make_tensor_value_info("on", kinds.BOOL, []),
            helper.make_tensor_value_info("after", kinds.FLOAT, ["batch", 5]),
        ],
    )
    graph = helper.make_graph(
        [
            helper.make_node("ReduceMax", ["observation"], ["largest"], keepdims=0),
            helper.make_node("Greater", ["largest", "zero"], ["go"]),
            helper.make_node("Loop", ["many", "go", "observation"], ["end"], body=body),
            helper.make_node("ReduceSum", ["end"], ["action"], keepdims=1),
        ],
        "policy",
        [helper.make_tensor_value_info("observation", kinds.FLOAT, ["batch", 5])],
        [helper.make_tensor_value_info("action", kinds.FLOAT, ["batch", 1])],
        [
            helper.make_tensor("zero", kinds.FLOAT, [], [0.0]),
            helper.make_tensor("many", kinds.INT64, [], [2**62]),
        ],
    )
    save_network(graph, file)
    monkeypatch.setattr("gauge_envs.tools.transfer.policies.load.MOST_ONNX_CPU_S", 3)
    policy = load_policy(str(file), env)
    with pytest.raises(PolicyError, match=r"bomb\.onnx: the network needs more than"):
        policy(np.ones(5))
    file.write_bytes(b"no network")
    refused(r"bomb\.onnx: it is no network that onnxruntime can load", file, env)


# --- any source ---


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (
            "policy.pt",
            r"expected a \.zip of Stable-Baselines3, a \.onnx, or module:function",
        ),
        ("missing.zip", "missing.zip: cannot be read: No such file"),
        ("os:getcwd", "importing a module runs its code: add --trust"),
    ],
)
def test_what_is_no_policy_is_named(source, reason, env):
    refused(reason, source, env)


def test_a_zip_that_is_no_policy_is_named(env, tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("readme", "hello")
    refused(r"expected the parts data and policy\.pth", tmp_path / "a.zip", env)
    (tmp_path / "b.zip").write_bytes(b"no archive")
    refused("no policy of Stable-Baselines3: ", tmp_path / "b.zip", env)


def test_a_function_of_a_module(env):
    refused("the policy raised TypeError", "os:getcwd", env, trust=True)
    refused("the import raised AttributeError", "os:nothing", env, trust=True)
    assert load_policy("numpy:mean", env, trust=True)(np.full(5, 0.25)) == 0.25


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (":act", "the import raised ValueError"),
        (".mine:act", "the import raised TypeError"),
        ("fails:act", "the import raised ZeroDivisionError"),
        ("exits:act", "the import raised SystemExit: 3"),
        ("wrong:act", "the import raised SyntaxError"),
        ("odd:act", "the policy raised SystemExit: 4"),
        ("odd:other", "the import raised ZeroDivisionError"),
    ],
)
def test_a_module_that_breaks_is_an_error(source, reason, env, tmp_path, monkeypatch):
    odd = "import sys\ndef act(_):\n    sys.exit(4)\ndef __getattr__(_):\n    1 / 0\n"
    texts = {
        "fails": "1 / 0",
        "exits": "import sys; sys.exit(3)",
        "wrong": "def",
        "odd": odd,
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    refused(reason, source, env, trust=True)


def test_actions_are_checked(env):
    with pytest.raises(PolicyError, match=r"mine: the action is \[nan\]"):
        checked_policy("mine", lambda _: np.array([np.nan]), env)
    assert checked_policy("mine", lambda _: np.array([7.0]), env)(np.zeros(5)) == 1.0


def test_numbers_of_files_must_fit(env):
    with pytest.raises(PolicyError, match="given twice"):
        load_policies(["a.zip", "a.zip"], env)
    with pytest.raises(PolicyError, match="2 files of statistics for 3 policies"):
        load_policies(
            ["a.zip", "b.zip", "c.zip"], env, normalization=[Path("x"), Path("y")]
        )
