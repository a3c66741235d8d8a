"""Policies of other packages: they act as in the package that saved them, and loading them runs no code."""

from __future__ import annotations

import io
import json
import pickle
import sys
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gauge_envs.errors import PolicyError
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.transfer.policies.load import checked_policy, load_policies, load_policy, read_normalization
from gauge_envs.tools.transfer.policy_replays import make_control_env

TASK = "Pendulum-Limit-metal"


@pytest.fixture(scope="module")
def env() -> ControlEnv:
    return make_control_env(TASK)


def observations() -> np.ndarray:
    return 3.0 * np.random.default_rng(0).normal(size=(40, 5))


class Evil:
    """Object whose unpickling writes a file."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self):
        return (Path.touch, (self.file,))


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
def test_an_actor_from_weights_acts_as_the_package_that_saved_it(name, kwargs, env, tmp_path) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    torch = pytest.importorskip("torch")
    if "activation_fn" in kwargs:
        kwargs = kwargs | {"activation_fn": getattr(torch.nn, kwargs["activation_fn"])}
    model = getattr(sb3, name)("MlpPolicy", env, policy_kwargs=kwargs, device="cpu", seed=1)
    file = tmp_path / "policy.zip"
    model.save(file)
    policy = load_policy(str(file), env)
    for observation in observations():
        expected = model.predict(observation, deterministic=True)[0]
        # SAC and TD3 scale their action to the space and round once more.
        assert policy(observation) == pytest.approx(expected, abs=1e-7)


def test_a_network_that_weights_do_not_state_needs_trust(env, tmp_path) -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    model = sb3.PPO("MlpPolicy", env, policy_kwargs={"squash_output": True}, use_sde=True, device="cpu")
    file = tmp_path / "policy.zip"
    model.save(file)
    with pytest.raises(PolicyError, match=r"gSDE.*runs code.*--trust"):
        load_policy(str(file), env)
    trusted = load_policy(str(file), env, trust=True)
    observation = observations()[0]
    assert trusted(observation) == pytest.approx(model.predict(observation, deterministic=True)[0])


def write_sb3(file: Path, sizes: tuple[int, ...], *, evil: Path | None = None, **data: object) -> Path:
    torch = pytest.importorskip("torch")
    weights = {}
    for number, (before, after) in enumerate(pairwise(sizes)):
        name = "action_net." if number == len(sizes) - 2 else f"mlp_extractor.policy_net.{2 * number}."
        weights |= {f"{name}weight": torch.ones(after, before), f"{name}bias": torch.zeros(after)}
    stream = io.BytesIO()
    torch.save(weights if evil is None else {"weight": Evil(evil)}, stream)
    stated = {"policy_class": {"__module__": "stable_baselines3.common.policies"}, "policy_kwargs": {}} | data
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", json.dumps(stated))
        archive.writestr("policy.pth", stream.getvalue())
    return file


def test_a_policy_of_another_task_is_refused(env, tmp_path) -> None:
    with pytest.raises(PolicyError, match="7 entries of the observation, the task has 5"):
        load_policy(str(write_sb3(tmp_path / "a.zip", (7, 4, 1))), env)
    with pytest.raises(PolicyError, match="2 entries of the action, the task has 1"):
        load_policy(str(write_sb3(tmp_path / "b.zip", (5, 4, 2))), env)


def test_weights_that_hold_code_are_refused_and_do_not_run(env, tmp_path) -> None:
    mark = tmp_path / "ran"
    with pytest.raises(PolicyError, match="holds no weights"):
        load_policy(str(write_sb3(tmp_path / "a.zip", (5, 4, 1), evil=mark)), env)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ({"policy_class": {"__module__": "mine"}}, "module 'mine'"),
        ({"policy_kwargs": {"features_extractor_class": "<class 'mine.Net'>"}}, "features_extractor_class"),
        ({"policy_kwargs": {"activation_fn": "<class 'mine.Swish'>"}}, "activation is <class 'mine.Swish'>"),
        ({"use_sde": True}, "gSDE"),
    ],
)
def test_what_may_change_the_network_needs_trust(data, reason, env, tmp_path) -> None:
    with pytest.raises(PolicyError, match=f"{reason}.*--trust"):
        load_policy(str(write_sb3(tmp_path / "a.zip", (5, 4, 1), **data)), env)


@pytest.mark.parametrize("data", [b"[]", b"null", b"[" * 9000, b"\xff", b" " * 17_000_000])
def test_damaged_data_is_no_policy(data: bytes, env, tmp_path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data", data)
        archive.writestr("policy.pth", b"PK")
    with pytest.raises(PolicyError, match=r"a\.zip: it is no policy of Stable-Baselines3"):
        load_policy(str(tmp_path / "a.zip"), env)


def test_weights_that_unpack_to_gigabytes_are_refused(env, tmp_path) -> None:
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data/0", b"a" * 1000)
    # The size that the directory states, twice in 4 bytes.
    lied = inner.getvalue().replace((1000).to_bytes(4, "little"), (10**9).to_bytes(4, "little"))
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("data", "{}")
        archive.writestr("policy.pth", lied)
    with pytest.raises(PolicyError, match=r"policy\.pth unpacks to more than 512 MB"):
        load_policy(str(tmp_path / "a.zip"), env)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda torch: {1: torch.ones(1)}, "holds no weights"),
        (lambda torch: {"mlp_extractor.policy_net.abc.weight": torch.ones(4, 5)}, "are not numbered"),
        (lambda torch: {"action_net.weight": torch.ones(1, 4).to_sparse()}, "holds no plain numbers"),
        (lambda torch: {"action_net.weight": torch.ones(1, 4, device="meta")}, "holds no plain numbers"),
        (
            lambda torch: {"mlp_extractor.policy_net.2.weight": torch.ones(1).expand(10**5, 10**5)},
            "more numbers than policy.pth holds",
        ),
    ],
)
def test_damaged_weights_are_refused(change, reason, env, tmp_path) -> None:
    torch = pytest.importorskip("torch")
    file = write_sb3(tmp_path / "a.zip", (5, 4, 1))
    with zipfile.ZipFile(file) as archive:
        data, weights = archive.read("data"), torch.load(io.BytesIO(archive.read("policy.pth")))
    stream = io.BytesIO()
    torch.save(weights | change(torch), stream)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", data)
        archive.writestr("policy.pth", stream.getvalue())
    with pytest.raises(PolicyError, match=reason):
        load_policy(str(file), env)


# --- statistics ---


def test_statistics_are_those_of_vec_normalize(env, tmp_path) -> None:
    vec = pytest.importorskip("stable_baselines3.common.vec_env", reason="extra 'rl' is not installed")
    scaled = vec.VecNormalize(vec.DummyVecEnv([lambda: make_control_env(TASK)]), clip_obs=2.0)
    scaled.obs_rms.update(observations())
    scaled.save(str(tmp_path / "norm.pkl"))
    statistics = read_normalization(tmp_path / "norm.pkl", observation_size=5)
    for observation in observations():
        assert np.array_equal(statistics.apply(observation), scaled.normalize_obs(observation))
    with pytest.raises(PolicyError, match=r"shape \(5,\), the task has \(3,\)"):
        read_normalization(tmp_path / "norm.pkl", observation_size=3)


def test_statistics_are_read_without_running_code(tmp_path) -> None:
    mark, file = tmp_path / "ran", tmp_path / "norm.pkl"
    file.write_bytes(pickle.dumps({"obs_rms": Evil(mark)}))
    with pytest.raises(PolicyError, match="expected a file of VecNormalize"):
        read_normalization(file, observation_size=5)
    assert not mark.exists()


class VecNormalize:
    """Stand-in of the class in files of `VecNormalize.save`."""


def write_statistics(file: Path, *, protocol: int = 4, **changes: object) -> Path:
    saved, saved.obs_rms = VecNormalize(), VecNormalize()
    saved.obs_rms.mean, saved.obs_rms.var = changes.pop("mean", np.arange(5.0)), changes.pop("var", np.ones(5))
    vars(saved).update({"clip_obs": 10.0, "epsilon": 1e-8, "names": np.array(["a", None]), **changes})
    file.write_bytes(pickle.dumps(saved, protocol=protocol))
    return file


@pytest.mark.parametrize("protocol", [3, 4, 5])
@pytest.mark.parametrize("kind", ["<f8", ">f8", "<f4", "<i4"])
def test_statistics_of_any_numbers_are_read(kind: str, protocol: int, tmp_path) -> None:
    mean = np.arange(5).astype(kind)
    file = write_statistics(tmp_path / "norm.pkl", protocol=protocol, mean=mean, clip_obs=np.float32(2.0))
    statistics = read_normalization(file, observation_size=5)
    assert np.array_equal(statistics.mean, np.arange(5.0)) and statistics.clip == 2.0


@pytest.mark.parametrize(
    "changes",
    [
        {"mean": np.full(5, np.nan)},
        {"var": -np.ones(5)},
        {"var": np.zeros(5), "epsilon": 0.0},
        {"clip_obs": float("nan")},
        {"clip_obs": 10**400},
        {"mean": [10**400] * 5},
        {"mean": np.array(list("abcde"))},
        {"mean": np.ones(5) * 1j},
        {"mean": np.array([None] * 5)},
    ],
)
def test_statistics_that_are_no_numbers_are_refused(changes, tmp_path) -> None:
    with pytest.raises(PolicyError, match=r"norm\.pkl: expected"):
        read_normalization(write_statistics(tmp_path / "norm.pkl", **changes), observation_size=5)


HUGE = b"(\x8a\x05" + (10**11).to_bytes(5, "little") + b"t"
"""The tuple (100_000_000_000,) in a pickle."""


@pytest.mark.parametrize(
    "content",
    [
        b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\n" + HUGE + b"C\x01b\x87R.",
        b"cnumpy\nndarray\n" + HUGE + b"\x85R.",
        b"cnumpy\ndtype\nX\x02\x00\x00\x00f8\x89\x88\x87R(K\x03X\x01\x00\x00\x00<NNNK\x01K\x01K\x3ftb.",
        b"cnumpy.core.numeric\n_frombuffer\n" + HUGE + b"R.",
        b"\x8b\xff\xff\xff\x7f.",
        b"Nr\xff\xff\xff\x3f.",
        b"[" * 5000,
        b"I" + b"9" * 5000 + b"\n.",
        b"",
    ],
)
def test_a_damaged_pickle_reaches_no_code_of_numpy(content: bytes, tmp_path) -> None:
    file = tmp_path / "norm.pkl"
    file.write_bytes(b"\x80\x02" + content)
    with pytest.raises(PolicyError, match=r"expected a file of VecNormalize\.save"):
        read_normalization(file, observation_size=5)


# --- ONNX ---


def write_onnx(file: Path, size: int, *, outputs: int = 1) -> Path:
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime", reason="extra 'onnx' is not installed")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    weights = helper.make_tensor("w", kind, [size, outputs], np.full(size * outputs, 0.1).tolist())
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "w"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", kind, ["batch", size])],
        [helper.make_tensor_value_info("action", kind, ["batch", outputs])],
        [weights],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), file)
    return file


def test_an_onnx_policy_acts_as_its_network_and_is_clipped(env, tmp_path) -> None:
    policy = load_policy(str(write_onnx(tmp_path / "a.onnx", 5)), env)
    for observation in observations():
        expected = np.clip(0.1 * observation.sum(), -1.0, 1.0)
        assert policy(observation) == pytest.approx(expected, abs=1e-6)
    with pytest.raises(PolicyError, match="observation has 5 entries"):
        load_policy(str(write_onnx(tmp_path / "b.onnx", 6)), env)
    with pytest.raises(PolicyError, match=r"action has shape \(3,\), the task takes \(1,\)"):
        load_policy(str(write_onnx(tmp_path / "c.onnx", 5, outputs=3)), env)


def test_an_onnx_file_is_run_within_limits_first(env, tmp_path, monkeypatch) -> None:
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
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), file)
    with pytest.raises(PolicyError, match=r"bomb\.onnx: onnxruntime cannot run the network"):
        load_policy(str(file), env)
    # A network that is cheap for zeros and a loop without end for the task's own observations.
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Identity", ["before"], ["after"])],
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
        [helper.make_tensor("zero", kinds.FLOAT, [], [0.0]), helper.make_tensor("many", kinds.INT64, [], [2**62])],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), file)
    monkeypatch.setattr("gauge_envs.tools.transfer.policies.load.MOST_ONNX_CPU_S", 3)
    policy = load_policy(str(file), env)
    with pytest.raises(PolicyError, match=r"bomb\.onnx: the network needs more than"):
        policy(np.ones(5))
    file.write_bytes(b"no network")
    with pytest.raises(PolicyError, match=r"bomb\.onnx: it is no network that onnxruntime can load"):
        load_policy(str(file), env)


# --- any source ---


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("policy.pt", r"expected a \.zip of Stable-Baselines3, a \.onnx, or module:function"),
        ("missing.zip", "missing.zip: cannot be read: No such file"),
        ("os:getcwd", "importing a module runs its code: add --trust"),
    ],
)
def test_what_is_no_policy_is_named(source: str, reason: str, env) -> None:
    with pytest.raises(PolicyError, match=reason):
        load_policy(source, env)


def test_a_zip_that_is_no_policy_is_named(env, tmp_path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("readme", "hello")
    with pytest.raises(PolicyError, match=r"expected the parts data and policy\.pth"):
        load_policy(str(tmp_path / "a.zip"), env)
    (tmp_path / "b.zip").write_bytes(b"no archive")
    with pytest.raises(PolicyError, match="no policy of Stable-Baselines3: "):
        load_policy(str(tmp_path / "b.zip"), env)


def test_a_function_of_a_module(env) -> None:
    with pytest.raises(PolicyError, match="the policy raised TypeError"):
        load_policy("os:getcwd", env, trust=True)
    with pytest.raises(PolicyError, match="module 'os' has no 'nothing'"):
        load_policy("os:nothing", env, trust=True)
    assert load_policy("numpy:mean", env, trust=True)(np.full(5, 0.25)) == 0.25


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (":act", "importing the module raised ValueError: "),
        (".mine:act", "importing the module raised TypeError"),
        ("fails:act", "importing the module raised ZeroDivisionError"),
        ("exits:act", "importing the module raised SystemExit: 3"),
        ("wrong:act", "importing the module raised SyntaxError"),
        ("odd:act", "the policy raised SystemExit: 4"),
        ("odd:other", "reading 'other' raised ZeroDivisionError"),
    ],
)
def test_a_module_that_breaks_is_an_error(source: str, reason: str, env, tmp_path, monkeypatch) -> None:
    odd = "import sys\ndef act(_):\n    sys.exit(4)\ndef __getattr__(_):\n    1 / 0\n"
    texts = {"fails": "1 / 0", "exits": "import sys; sys.exit(3)", "wrong": "def", "odd": odd}
    for name, text in texts.items():
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PolicyError, match=reason):
        load_policy(source, env, trust=True)


def test_actions_are_checked(env) -> None:
    with pytest.raises(PolicyError, match=r"mine: the action is \[nan\]"):
        checked_policy("mine", lambda _: np.array([np.nan]), env)
    assert checked_policy("mine", lambda _: np.array([7.0]), env)(np.zeros(5)) == 1.0


def test_numbers_of_files_must_fit(env) -> None:
    with pytest.raises(PolicyError, match="given twice"):
        load_policies(["a.zip", "a.zip"], env)
    with pytest.raises(PolicyError, match="2 files of statistics for 3 policies"):
        load_policies(["a.zip", "b.zip", "c.zip"], env, normalization=[Path("x"), Path("y")])
