"""The DP3 policy plugin: its networks, its average, its normalisation and its options."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy, make_policy_config, make_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor, nn

from lerobot_policy_dp3 import DP3Config, DP3Policy
from lerobot_policy_dp3.clouds import bounds_of
from lerobot_policy_dp3.configuration_dp3 import SIZES
from lerobot_policy_dp3.encoder import PointNet
from lerobot_policy_dp3.original import from_original, import_original

CLOUD = "observation.point_cloud"
JOINTS, POINTS = 7, 50
TINY: dict[str, Any] = {"down_dims": (16, 32), "diffusion_step_embed_dim": 16}


def config(channels: int = 3, **options) -> DP3Config:
    features = {
        OBS_STATE: PolicyFeature(FeatureType.STATE, (JOINTS,)),
        CLOUD: PolicyFeature(FeatureType.STATE, (POINTS, channels)),
        "observation.environment_state": PolicyFeature(FeatureType.ENV, (3,)),
    }
    outputs = {ACTION: PolicyFeature(FeatureType.ACTION, (JOINTS,))}
    return DP3Config(device="cpu", input_features=features, output_features=outputs, **(TINY | options))


def windows(batch: int = 4, channels: int = 3) -> dict[str, Tensor]:
    torch.manual_seed(0)
    return {
        OBS_STATE: torch.randn(batch, 2, JOINTS),
        CLOUD: torch.randn(batch, 2, POINTS, channels),
        ACTION: torch.rand(batch, 16, JOINTS) * 2 - 1,
    }


@pytest.mark.parametrize("channels", [(8, 12, 16), (8, 12, 16, 20)])
def test_training_looks_at_few_points_with_the_same_result_and_gradient(channels):
    torch.manual_seed(0)
    net, points = PointNet(3, channels, 5).double(), torch.randn(3, 200, 3, dtype=torch.double)
    points[1, 100:] = points[1, 0]  # as where a cloud was filled up
    plain = net.final_projection(net.mlp(points).max(dim=1).values)
    wanted = torch.autograd.grad(plain.square().sum(), list(net.parameters()))
    looked_at = []
    watched = net.mlp.register_forward_pre_hook(lambda _, given: looked_at.append(given[0].shape[1]))
    found = net(points)
    watched.remove()
    torch.testing.assert_close(found, plain)
    for ours, theirs in zip(torch.autograd.grad(found.square().sum(), list(net.parameters())), wanted, strict=True):
        torch.testing.assert_close(ours, theirs)
    assert looked_at[0] == 200
    assert looked_at[1] < 60  # with gradients
    assert len(looked_at) == 2
    with torch.no_grad():
        torch.testing.assert_close(net(points), plain)


def test_training_sees_other_points_and_joints_each_time_and_the_same_when_repeated():
    policy, batch = DP3Policy(config(points=10, random_points=True, state_noise=0.5)), windows(256)
    seen = []
    policy.model.compute_loss = lambda batch, _: seen.append(batch) or torch.zeros(())
    for step in (0, 0, 1):
        policy.average.n_averaged.fill_(step)
        policy.forward(batch)
    for key in (OBS_STATE, CLOUD):
        torch.testing.assert_close(seen[0][key], seen[1][key])
        assert not torch.equal(seen[0][key], seen[2][key])
    torch.testing.assert_close(seen[0][ACTION], batch[ACTION])
    noise = seen[0][OBS_STATE] - batch[OBS_STATE]
    torch.testing.assert_close(noise[:, 0], noise[:, 1])
    assert noise.std() == pytest.approx(0.5, rel=0.1)
    assert seen[0][CLOUD].shape == (256, 2, 10, 3)
    for point in seen[0][CLOUD][3, 1]:
        assert (batch[CLOUD][3, 1] == point).all(dim=1).any()
    policy.eval()
    policy.forward(batch)
    assert all(seen[3][key] is batch[key] for key in batch)  # nothing of it where it acts


def test_what_has_learnt_from_points_chosen_at_random_acts_on_some_chosen_at_random():
    """Always the same: the first of a cloud are spread otherwise than any that it has seen."""
    policy, batch = DP3Policy(config(points=10, random_points=True)).eval(), windows()
    seen: list[Tensor] = []
    encode = policy.model.obs_encoder.forward
    policy.model.obs_encoder.forward = lambda cloud, state: seen.append(cloud) or encode(cloud, state)
    for _ in range(2):
        policy.predict_action_chunk(batch)
    clouds = policy.model.clouds(batch).flatten(0, 1) * policy.model.cloud_scale + policy.model.cloud_offset
    chosen = [int((clouds[0] == point).all(dim=1).nonzero()) for point in seen[0][0]]
    assert len({*chosen}) == 10 and sorted(chosen) != [*range(10)]
    torch.testing.assert_close(seen[0], clouds[:, chosen], rtol=0, atol=0)
    torch.testing.assert_close(seen[1], seen[0], rtol=0, atol=0)


def test_it_learns_a_constant_and_its_average_acts():
    torch.manual_seed(1)
    policy = DP3Policy(config())
    batch = windows() | {ACTION: torch.full((4, 16, JOINTS), 0.5)}
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)
    for _ in range(150):
        loss, _ = policy(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        policy.update()
    assert loss < 0.01
    observation = {key: value[:, 0] for key, value in batch.items() if key != ACTION}
    action = policy.select_action(observation)
    torch.testing.assert_close(action, torch.full_like(action, 0.5), atol=0.1, rtol=0)
    with torch.no_grad():
        for weight in policy.model.parameters():
            weight.zero_()
    policy.reset()
    torch.testing.assert_close(policy.select_action(observation), action, atol=0.1, rtol=0)


def test_its_optimizer_steps_as_adamw_does():
    torch.manual_seed(2)
    ours, theirs = nn.Linear(5, 4), nn.Linear(5, 4)
    theirs.load_state_dict(ours.state_dict())
    start = ours.weight.detach().clone()
    preset = config(optimizer_weight_decay=0.1).get_optimizer_preset()
    plain = torch.optim.AdamW(theirs.parameters(), preset.lr, preset.betas, preset.eps, preset.weight_decay)
    for net, optimizer in ((ours, preset.build(ours.parameters())), (theirs, plain)):
        for step in range(20):
            optimizer.zero_grad()
            net(torch.full((3, 5), 0.1 * step)).square().sum().backward()
            optimizer.step()
    torch.testing.assert_close(ours.weight, theirs.weight, rtol=1e-5, atol=1e-7)
    assert (ours.weight - start).abs().max() > 1e-4


def test_the_average_follows_the_weights_as_in_dp3():
    """DP3's `EMAModel` asks for the decay of a step before it counts it, which starts the average one step later than diffusers'
    of today: steps 0 and 1 copy, step 2 decays by 1 - 2 ** -0.75."""
    policy = DP3Policy(config())
    weight, average = policy.model.obs_encoder.state_mlp[0].bias, policy.average.module.obs_encoder.state_mlp[0].bias
    values, decays, expected = [5.0, -3.0, 1.0, 0.5, 2.0, 7.0], [0.0, 0.0, 0.405396, 0.561309, 0.646447, 0.700930], 0.0
    for value, decay in zip(values, decays, strict=True):
        with torch.no_grad():
            weight.fill_(value)
        policy.update()
        expected = decay * expected + (1 - decay) * value
        torch.testing.assert_close(average, torch.full_like(average, expected), rtol=0, atol=2e-5)
    assert not any(p.requires_grad for p in policy.average.parameters())


def test_the_average_is_that_of_diffusers_one_step_later():
    from diffusers.training_utils import EMAModel

    policy, weight = DP3Policy(config(ema_max_decay=0.9)), nn.Parameter(torch.zeros(3))
    theirs = EMAModel([weight], decay=0.9, use_ema_warmup=True, inv_gamma=1.0, power=0.75)
    ours, averaged = (m.obs_encoder.state_mlp[0].bias for m in (policy.model, policy.average.module))
    torch.manual_seed(3)
    for step in range(40):
        with torch.no_grad():
            ours.fill_(float(value := torch.randn(())))
            weight.fill_(float(value))
        policy.update()
        if step:  # its first counts as DP3's second
            theirs.step([weight])
        else:
            theirs.shadow_params[0].copy_(weight)
        torch.testing.assert_close(averaged, theirs.shadow_params[0][:1].expand_as(averaged))


def test_a_saved_policy_loads_with_its_average(tmp_path):
    policy = DP3Policy(config())
    policy.update()
    with torch.no_grad():
        policy.model.obs_encoder.state_mlp[0].bias.add_(1)
    policy.update()
    policy.save_pretrained(tmp_path)
    loaded = DP3Policy.from_pretrained(tmp_path)
    assert loaded.config == policy.config
    for (name, ours), theirs in zip(policy.state_dict().items(), loaded.state_dict().values(), strict=True):
        torch.testing.assert_close(theirs, ours, msg=name)
    assert loaded.average.n_averaged == 2


def test_actions_are_executed_from_now_on_and_then_predicted_anew():
    policy = DP3Policy(config(n_action_steps=3)).eval()
    batch = windows(2)
    noise = torch.randn(2, 16, JOINTS)
    chunk = policy.predict_action_chunk(batch, noise)
    assert chunk.shape == (2, 3, JOINTS)
    first, second = ({key: value[:, i] for key, value in batch.items() if key != ACTION} for i in (0, 1))
    policy.reset()
    policy.select_action(first, noise)  # predicts, from the first observation twice
    for _ in range(2):
        policy.select_action(second, noise)
    torch.testing.assert_close(policy.select_action(second, noise), policy.predict_action_chunk({}, noise)[:, 0])
    policy.reset()
    twice = {key: torch.stack([value, value], dim=1) for key, value in first.items()}
    torch.testing.assert_close(policy.predict_action_chunk(twice, noise)[:, 0], policy.select_action(first, noise))
    policy.reset()
    torch.testing.assert_close(policy.predict_action_chunk(first, noise), policy.predict_action_chunk(twice, noise))


def test_only_the_state_and_the_clouds_first_points_count():
    policy = DP3Policy(config(6, points=20)).eval()
    batch, noise = windows(2, 6), torch.randn(2, 16, JOINTS)
    wanted = policy.predict_action_chunk(batch, noise)
    other = {**batch, CLOUD: batch[CLOUD].clone(), "observation.environment_state": torch.ones(2, 2, 3)}
    other[CLOUD][:, :, 20:] = 7
    other[CLOUD][..., 3:] = 7  # colours, not asked for
    torch.testing.assert_close(policy.predict_action_chunk(other, noise), wanted)
    other[CLOUD][:, :, :20, 0] = 7
    assert not torch.allclose(policy.predict_action_chunk(other, noise), wanted)
    coloured = DP3Policy(config(6, use_colours=True)).eval()
    grey = {**batch, CLOUD: torch.cat([batch[CLOUD][..., :3], torch.zeros(2, 2, POINTS, 3)], dim=-1)}
    assert not torch.allclose(coloured.predict_action_chunk(batch, noise), coloured.predict_action_chunk(grey, noise))


def test_what_hardly_moves_is_not_blown_up():
    stats = {
        OBS_STATE: {"min": torch.zeros(JOINTS), "max": torch.tensor([1.0] * 5 + [0.0, 1e-6])},
        ACTION: {"min": torch.zeros(JOINTS), "max": torch.ones(JOINTS)},
        CLOUD: {"min": torch.zeros(3), "max": torch.full((3,), 0.04)},
    }
    before, after = make_pre_post_processors(config(), dataset_stats=stats)
    state = torch.tensor([[0.0, 1.0, 0.5, 0.0, 0.0, 0.01, -0.05]])
    seen = before({OBS_STATE: state})
    torch.testing.assert_close(
        seen[OBS_STATE], torch.tensor([[-1.0, 1.0, 0.0, -1.0, -1.0, 0.2, -1.0]]), atol=1e-4, rtol=0
    )
    torch.testing.assert_close(after(torch.ones(1, JOINTS)), torch.ones(1, JOINTS))
    torch.testing.assert_close(after(-torch.ones(1, JOINTS)), torch.zeros(1, JOINTS))


# -- clouds as datasets have them ---------------------------------------------------------------------------------

LAYOUT = {"shape": [POINTS, 3], "columns": ["x_m", "y_m", "z_m"]}
LOW, HIGH = (-0.5, 0.25, 0.8), (0.5, 1.25, 0.8)  # z does not change
DATASET = {  # its shape, and what else describes it
    "flat": ((POINTS * 3,), {"names": None, "info": LAYOUT}),
    "2-D": ((POINTS, 3), {"names": ["point", "xyz_m"]}),
}


def clouds(frames: int) -> np.ndarray:
    """(frames, POINTS, 3) float32 from LOW to HIGH, which no frame has all of."""
    rng = np.random.default_rng(0)
    found = rng.uniform(LOW, HIGH, (frames, POINTS, 3)).clip(np.array(LOW) + 1e-3, np.array(HIGH) - 1e-3)
    found[..., 2] = 0.8
    found[3, 7, 0], found[9, 1, 1], found[4, 0, 0], found[11, 49, 1] = LOW[0], LOW[1], HIGH[0], HIGH[1]
    return found.astype(np.float32)


@pytest.fixture(scope="module", params=DATASET)
def dataset(request, tmp_path_factory):
    """Its layout, and a dataset of that, as LeRobot writes it, with statistics of flat clouds only where LeRobot makes some."""
    shape, description = DATASET[request.param]
    root = tmp_path_factory.mktemp("dp3") / "clouds"
    joints = {"dtype": "float32", "shape": (JOINTS,), "names": None}
    features = {OBS_STATE: joints, ACTION: joints, CLOUD: {"dtype": "float32", "shape": shape, **description}}
    made = LeRobotDataset.create("me/clouds", 10, features, root=root, use_videos=False)
    for t, cloud in enumerate(clouds(12)):
        qpos = np.full(JOINTS, t / 10, np.float32)
        made.add_frame({OBS_STATE: qpos, ACTION: qpos, CLOUD: cloud.reshape(shape), "task": "x"})
        if t in (5, 11):
            made.save_episode()
    made.finalize()
    if request.param == "flat":  # cei-convert makes none, `recompute_stats` does
        (root / "meta/stats.json").rename(root / "meta/made.json")
        stats = json.loads((root / "meta/made.json").read_text())
        stats.pop(CLOUD)
        (root / "meta/stats.json").write_text(json.dumps(stats))
    return request.param, LeRobotDataset("me/clouds", root)


def test_clouds_of_any_layout_are_normalised_by_their_channels_bounds(dataset):
    layout, data = dataset
    made = DP3Config(device="cpu", **TINY)
    policy = make_policy(made, ds_meta=data.meta)
    assert isinstance(policy, DP3Policy)
    assert policy.config.cloud_feature.shape == (POINTS, 3)
    np.testing.assert_allclose(policy.config.cloud_bounds, [LOW, HIGH], rtol=0, atol=1e-7)
    before, _ = make_pre_post_processors(policy.config, dataset_stats=data.meta.stats)
    seen = before({key: data[4][key][None] for key in (OBS_STATE, CLOUD)})
    torch.testing.assert_close(seen[CLOUD][0], data[4][CLOUD])  # the policy does it
    looked_at = []
    policy.model.obs_encoder.forward = lambda cloud, state: looked_at.append(cloud) or torch.zeros(len(cloud), 128)
    policy.select_action(seen)
    expected = clouds(12)[4].astype(float)
    expected = np.stack([2 * expected[:, 0], 2 * (expected[:, 1] - 0.75), 0 * expected[:, 2]], axis=1)
    np.testing.assert_allclose(looked_at[0][0], expected, rtol=0, atol=1e-6)
    if layout == "flat":
        made = json.loads((data.root / "meta/made.json").read_text())  # of each of its entries
        (low, high) = bounds_of(CLOUD, 3, made, None)
        np.testing.assert_allclose([low, high], [LOW, HIGH], rtol=0, atol=1e-7)


def test_a_policy_acts_alike_on_flat_clouds_and_others():
    policy = DP3Policy(config(random_points=True, points=20, cloud_bounds=((-1.0, -2.0, 0.0), (1.0, 2.0, 3.0)))).eval()
    batch, noise = windows(), torch.randn(4, 16, JOINTS)
    flat = {**batch, CLOUD: batch[CLOUD].flatten(-2)}
    torch.testing.assert_close(
        policy.predict_action_chunk(flat, noise), policy.predict_action_chunk(batch, noise), rtol=0, atol=0
    )
    policy.train()
    torch.testing.assert_close(policy(flat)[0], policy(batch)[0], rtol=0, atol=0)
    policy.eval()
    actions = []
    for seen in (flat, batch):
        policy.reset()
        observation = {key: value[:, 0] for key, value in seen.items() if key != ACTION}
        actions.append(policy.select_action(observation, noise))
    torch.testing.assert_close(*actions, rtol=0, atol=0)


def test_what_a_dataset_does_not_say_of_its_clouds_is_refused():
    flat = {"dtype": "float32", "shape": (POINTS * 3,), "names": None}
    for info in (None, {}, {"shape": [POINTS, 4]}, {"shape": [POINTS, 6]}, {"shape": POINTS}):
        with pytest.raises(ValueError, match=r"is flat, \(150,\), and its info.shape does not say"):
            config().set_dataset_feature_metadata({CLOUD: flat | {"info": info}})
    trained = config(cloud_bounds=((-1.0,) * 3, (1.0,) * 3))
    trained.pretrained_path = Path("checkpoint")
    trained.set_dataset_feature_metadata({CLOUD: flat | {"info": LAYOUT}})
    coloured = {"dtype": "float32", "shape": (POINTS * 6,), "names": None, "info": {"shape": [POINTS, 6]}}
    with pytest.raises(ValueError, match="has 6 channels, the policy was trained on 3"):
        trained.set_dataset_feature_metadata({CLOUD: coloured})
    trained.cloud_bounds = None
    with pytest.raises(ValueError, match="trained by an earlier version"):
        trained.set_dataset_feature_metadata({CLOUD: flat | {"info": LAYOUT}})


def test_bounds_that_nothing_tells_are_asked_for(dataset):
    _, data = dataset
    elsewhere = LeRobotDatasetMetadata("me/clouds", data.root)
    elsewhere.root, elsewhere.stats = data.root / "meta", {}  # as of a dataset that is streamed
    with pytest.raises(ValueError, match=r"give --policy\.cloud_bounds"):
        make_policy(DP3Config(device="cpu", **TINY), ds_meta=elsewhere)
    given = DP3Config(device="cpu", cloud_bounds=((-1.0,) * 3, (1.0,) * 3), **TINY)
    assert make_policy(given, ds_meta=elsewhere).config.cloud_bounds == ((-1.0,) * 3, (1.0,) * 3)


def test_a_trained_policy_keeps_its_bounds_where_it_is_trained_on(dataset, tmp_path):
    layout, data = dataset
    policy = make_policy(DP3Config(device="cpu", **TINY), ds_meta=data.meta)
    bounds = policy.config.cloud_bounds
    policy.save_pretrained(tmp_path)
    again = PreTrainedConfig.from_pretrained(tmp_path)
    again.pretrained_path = tmp_path
    assert isinstance(again, DP3Config) and again.cloud_bounds == bounds
    assert make_policy(again, ds_meta=data.meta).config.cloud_bounds == bounds
    # of an earlier version: its clouds were normalised before they came to it
    older = json.loads((tmp_path / "config.json").read_text())
    for field in ("cloud_bounds", "residual_blocks"):
        del older[field]
    (tmp_path / "config.json").write_text(json.dumps(older))
    again = PreTrainedConfig.from_pretrained(tmp_path)
    again.pretrained_path = tmp_path
    if layout == "2-D":
        loaded = make_policy(again, ds_meta=data.meta)
        assert loaded.config.cloud_bounds is None and loaded.config.residual_blocks == 2
    else:
        with pytest.raises(ValueError, match="trained by an earlier version"):
            make_policy(again, ds_meta=data.meta)


def test_it_is_registered_with_lerobot_by_name():
    made = make_policy_config("dp3", device="cpu", size="simple")
    assert isinstance(made, DP3Config)
    assert (made.down_dims, made.residual_blocks) == SIZES["simple"] == ((128, 256, 384), 1)
    assert made.drop_n_last_frames == 7
    assert made.observation_delta_indices == [-1, 0]
    assert made.action_delta_indices == list(range(-1, 15))


def weights_of(size: str, joints: int) -> int:
    """How many weights a policy of a robot with so many joints has."""
    made = config(size=size, down_dims=None, diffusion_step_embed_dim=128)
    made.input_features[OBS_STATE] = PolicyFeature(FeatureType.STATE, (joints,))
    made.output_features[ACTION] = PolicyFeature(FeatureType.ACTION, (joints,))
    return sum(weight.numel() for weight in DP3Policy(made).model.parameters())


def test_sizes_are_those_of_dp3_and_simple_dp3():
    assert weights_of("simple", 17) == 7_451_281  # of the original, for a UR5e with a Fourier hand
    assert 2.5e8 < weights_of("paper", 7) < 2.7e8


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"size": "huge"}, "Valid: paper, simple, small"),
        ({"horizon": 15}, "multiple of 2"),
        ({"n_action_steps": 16}, "more than the 15"),
        ({"prediction_type": "velocity"}, "Valid: sample, epsilon"),
        ({"state_noise": -1.0}, "policy.state_noise=-1.0 is less than 0"),
        ({"points": 51}, "the cloud has 50"),
        ({"use_colours": True}, "no colours"),
        ({"cloud_key": "observation.cloud"}, "needs a point cloud"),
        ({"residual_blocks": 3}, "policy.residual_blocks=3. Valid: 1, 2"),
        ({"cloud_bounds": ((0.0,) * 6, (1.0,) * 6)}, "least and the largest value of 3 channels"),
        ({"cloud_bounds": ((0.0,) * 3, (1.0, 1.0, -1.0))}, "least and the largest value of 3 channels"),
    ],
)
def test_bad_options_get_one_line(options, says):
    with pytest.raises(ValueError, match=says):
        DP3Policy(config(**options))


# -- the original's networks, by its names ------------------------------------------------------------------------


class Conv(nn.Module):
    def __init__(self, before: int, after: int, kernel: int) -> None:
        super().__init__()
        self.block = nn.Sequential(
            nn.Conv1d(before, after, kernel, padding=kernel // 2), nn.GroupNorm(8, after), nn.Mish()
        )

    def forward(self, x):
        return self.block(x)


class Residual(nn.Module):
    def __init__(self, before: int, after: int, condition: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList([Conv(before, after, 5), Conv(after, after, 5)])
        self.cond_encoder = nn.Sequential(nn.Mish(), nn.Linear(condition, 2 * after))
        self.residual_conv = nn.Conv1d(before, after, 1) if before != after else nn.Identity()

    def forward(self, x, condition):
        scale, bias = self.cond_encoder(condition).unsqueeze(-1).chunk(2, dim=1)
        return self.blocks[1](scale * self.blocks[0](x) + bias) + self.residual_conv(x)


class Wrapped(nn.Module):
    def __init__(self, conv: nn.Module) -> None:
        super().__init__()
        self.conv = conv

    def forward(self, x):
        return self.conv(x)


class Sinusoids(nn.Module):
    def __init__(self, half: int) -> None:
        super().__init__()
        self.half = half

    def forward(self, step):
        half = self.half
        angles = step[:, None] * torch.exp(torch.arange(half) * -(math.log(10000) / (half - 1)))[None]
        return torch.cat([angles.sin(), angles.cos()], dim=-1)


class OriginalUnet(nn.Module):
    """DP3's with two residual blocks a level, Simple DP3's with one."""

    def __init__(self, actions: int, condition: int, widths: tuple[int, ...], embed: int, blocks: int) -> None:
        super().__init__()
        c = condition + embed
        self.diffusion_step_encoder = nn.Sequential(
            Sinusoids(embed // 2), nn.Linear(embed, 4 * embed), nn.Mish(), nn.Linear(4 * embed, embed)
        )
        last = widths[-1]
        self.mid_modules = nn.ModuleList([Residual(last, last, c) for _ in range(blocks)])

        def level(before: int, after: int, layer: nn.Module) -> nn.ModuleList:
            return nn.ModuleList(
                [Residual(before, after, c), *([Residual(after, after, c)] if blocks == 2 else []), layer]
            )

        halve = [Wrapped(nn.Conv1d(w, w, 3, 2, 1)) for w in widths[:-1]] + [nn.Identity()]
        self.down_modules = nn.ModuleList(map(level, (actions, *widths[:-1]), widths, halve))
        double = [Wrapped(nn.ConvTranspose1d(w, w, 4, 2, 1)) for w in widths[-2::-1]]
        self.up_modules = nn.ModuleList(map(level, [2 * w for w in widths[:0:-1]], widths[-2::-1], double))
        self.final_conv = nn.Sequential(Conv(widths[0], widths[0], 5), nn.Conv1d(widths[0], actions, 1))

    def forward(self, sample, step, condition):
        condition = torch.cat([self.diffusion_step_encoder(step), condition], dim=-1)
        x, kept = sample.transpose(1, 2), []
        for *blocks, halve in self.down_modules:
            for block in blocks:
                x = block(x, condition)
            kept.append(x)
            x = halve(x)
        for middle in self.mid_modules:
            x = middle(x, condition)
        for *blocks, double in self.up_modules:
            x = torch.cat([x, kept.pop()], dim=1)
            for block in blocks:
                x = block(x, condition)
            x = double(x)
        return self.final_conv(x).transpose(1, 2)


class OriginalEncoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.extractor = nn.Module()
        layers = []
        for before, after in ((3, 64), (64, 128), (128, 256)):
            layers += [nn.Linear(before, after), nn.LayerNorm(after), nn.ReLU()]
        self.extractor.mlp = nn.Sequential(*layers)
        self.extractor.final_projection = nn.Sequential(nn.Linear(256, 64), nn.LayerNorm(64))
        self.state_mlp = nn.Sequential(nn.Linear(JOINTS, 64), nn.ReLU(), nn.Linear(64, 64))

    def forward(self, points, state):
        cloud = self.extractor.final_projection(torch.max(self.extractor.mlp(points), 1)[0])
        return torch.cat([cloud, self.state_mlp(state)], dim=-1)


class Normalizer(nn.Module):
    """The original's `LinearNormalizer`: minimum and maximum of each channel become -1 and 1; what hardly moves is centred."""

    def __init__(self, **data: Tensor) -> None:
        super().__init__()
        self.params_dict = nn.ParameterDict()
        for key, values in data.items():
            low, high = values.reshape(-1, values.shape[-1]).aminmax(dim=0)
            still = high - low < 1e-4
            scale = torch.where(still, 1.0, 2 / (high - low))
            of_key = {"scale": scale, "offset": torch.where(still, -low, -1 - scale * low)}
            stats = nn.ParameterDict({"min": low, "max": high})
            self.params_dict[key] = nn.ParameterDict({**of_key, "input_stats": stats}).requires_grad_(False)

    def normalize(self, key: str, x: Tensor) -> Tensor:
        return x * self.params_dict[key]["scale"] + self.params_dict[key]["offset"]

    def unnormalize(self, key: str, x: Tensor) -> Tensor:
        return (x - self.params_dict[key]["offset"]) / self.params_dict[key]["scale"]


class Original(nn.Module):
    def __init__(self, widths: tuple[int, ...] = (16, 32), embed: int = 16, blocks: int = 2, channels: int = 3) -> None:
        super().__init__()
        self.obs_encoder, self.model = OriginalEncoder(), OriginalUnet(JOINTS, 256, widths, embed, blocks)
        rad = torch.randn(40, JOINTS) * torch.linspace(1, 3, JOINTS) + 0.3
        rad[:, 2] = 0.7  # a joint that never moves
        cloud = torch.rand(5, 30, channels) * torch.linspace(0.3, 0.9, channels) + 0.6
        self.normalizer = Normalizer(agent_pos=rad, action=2 * rad + 1, point_cloud=cloud)
        self._dummy_variable = nn.Parameter()  # left out

    @torch.no_grad()
    def predict_action(self, state: Tensor, cloud: Tensor, noise: Tensor) -> Tensor:
        """(B, T, n) from (B, 2, ...) of what is seen."""
        points = self.normalizer.normalize("point_cloud", cloud)[..., :3]
        state = self.normalizer.normalize("agent_pos", state)
        features = self.obs_encoder(points.flatten(0, 1), state.flatten(0, 1)).reshape(len(state), -1)
        scheduler = DDIMScheduler(100, beta_schedule="squaredcos_cap_v2", prediction_type="sample", clip_sample=True)
        scheduler.set_timesteps(10)
        actions = noise
        for step in scheduler.timesteps:
            predicted = self.model(actions, step.expand(len(actions)), features)
            actions = scheduler.step(predicted, step, actions).prev_sample
        return self.normalizer.unnormalize("action", actions)


@pytest.mark.parametrize("blocks", [1, 2])
def test_weights_of_the_original_fit_by_their_names_and_act_alike(blocks: int):
    torch.manual_seed(2)
    original, policy = Original(blocks=blocks), DP3Policy(config(residual_blocks=blocks))
    policy.model.load_state_dict(from_original(original.state_dict()), strict=True)
    batch, noisy, step = windows(), torch.randn(4, 16, JOINTS), torch.tensor([0, 10, 50, 99])
    with torch.no_grad():
        features = original.obs_encoder(batch[CLOUD].flatten(0, 1), batch[OBS_STATE].flatten(0, 1)).reshape(4, -1)
        conditions = []
        unet = policy.model.unet
        unet.register_forward_pre_hook(lambda _, __, given: conditions.append(given["global_cond"]), with_kwargs=True)
        policy.model.compute_loss(batch)
        torch.testing.assert_close(conditions[0], features)
        torch.testing.assert_close(unet(noisy, step, global_cond=features), original.model(noisy, step, features))


def test_simple_dp3_is_the_originals_with_as_many_weights():
    torch.manual_seed(2)
    original = Original((128, 256, 384), 128, blocks=1)
    policy = DP3Policy(config(size="simple", down_dims=None, diffusion_step_embed_dim=128))
    policy.model.load_state_dict(from_original(original.state_dict()), strict=True)
    networks = (original.obs_encoder, original.model)
    assert weights_of("simple", JOINTS) == sum(p.numel() for net in networks for p in net.parameters())


@pytest.mark.parametrize(("stored", "seen"), [(3, 3), (6, 6), (6, 3)])
def test_an_imported_policy_acts_on_what_is_seen_as_the_original_does(stored: int, seen: int, tmp_path):
    torch.manual_seed(4)
    original = Original(channels=stored)
    for part in (*import_original(original.state_dict(), config(seen)),):
        part.save_pretrained(tmp_path)
    loaded = PreTrainedConfig.from_pretrained(tmp_path)
    before, after = make_pre_post_processors(loaded, pretrained_path=str(tmp_path))
    policy = DP3Policy.from_pretrained(tmp_path)
    state, noise = torch.randn(4, JOINTS), torch.randn(4, 16, JOINTS)
    cloud = torch.rand(4, POINTS, stored) * 0.5 + 0.5
    expected = original.predict_action(*(x[:, None].expand(-1, 2, *x.shape[1:]) for x in (state, cloud)), noise)
    chosen = policy.select_action(before({OBS_STATE: state, CLOUD: cloud[..., :seen]}), noise)
    torch.testing.assert_close(after(chosen), expected[:, 1], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"normalizer.params_dict.action.scale": None}, "no normaliser of action .*action.scale"),
        ({"normalizer.params_dict.action.scale": torch.ones(9)}, "of action is of 9 entries, not of 7"),
        (
            {"normalizer.params_dict.agent_pos.scale": torch.zeros(JOINTS)},
            "of agent_pos has a scale that is not above 0",
        ),
        ({"normalizer.params_dict.agent_pos.offset": torch.full((JOINTS,), torch.nan)}, "of agent_pos has a scale"),
        ({"normalizer.params_dict.point_cloud.scale": torch.full((3,), 1e6)}, "span less than 0.0001 m"),
        (
            {"normalizer.params_dict.imagin_robot.scale": torch.ones(3)},
            "looks at imagin_robot, which this policy does not",
        ),
    ],
)
def test_what_cannot_be_imported_is_refused(change: dict, says: str):
    weights = {key: value for key, value in (Original().state_dict() | change).items() if value is not None}
    with pytest.raises(ValueError, match=says):
        import_original(weights, config())
