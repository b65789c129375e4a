"""The DP3 policy plugin: its networks, its average, its normalisation and its options."""

import math
from typing import Any

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import make_policy_config, make_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor, nn

from lerobot_policy_dp3 import DP3Config, DP3Policy
from lerobot_policy_dp3.configuration_dp3 import SIZES
from lerobot_policy_dp3.encoder import PointNet
from lerobot_policy_dp3.original import from_original

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
    found = net(points)
    torch.testing.assert_close(found, plain)
    for ours, theirs in zip(torch.autograd.grad(found.square().sum(), list(net.parameters())), wanted, strict=True):
        torch.testing.assert_close(ours, theirs)
    assert net._largest(points).shape[1] < 60
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


def test_the_average_follows_the_weights_as_in_dp3():
    policy = DP3Policy(config())
    weight, average = policy.model.obs_encoder.state_mlp[0].bias, policy.average.module.obs_encoder.state_mlp[0].bias
    expected = None
    for step in range(20):
        with torch.no_grad():
            weight.fill_(step)
        policy.update()
        decay = min(0.9999, 1 - (1 + step) ** -0.75) if step else 0.0
        expected = step if expected is None else decay * expected + (1 - decay) * step
        torch.testing.assert_close(average, torch.full_like(average, expected))
    assert not any(p.requires_grad for p in policy.average.parameters())


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
    seen = before({OBS_STATE: state, CLOUD: torch.full((1, POINTS, 3), 0.04)})
    torch.testing.assert_close(
        seen[OBS_STATE], torch.tensor([[-1.0, 1.0, 0.0, -1.0, -1.0, 0.2, -1.0]]), atol=1e-4, rtol=0
    )
    torch.testing.assert_close(seen[CLOUD], torch.ones(1, POINTS, 3))
    torch.testing.assert_close(after(torch.ones(1, JOINTS)), torch.ones(1, JOINTS))
    torch.testing.assert_close(after(-torch.ones(1, JOINTS)), torch.zeros(1, JOINTS))


def test_it_is_registered_with_lerobot_by_name():
    made = make_policy_config("dp3", device="cpu", size="simple")
    assert isinstance(made, DP3Config)
    assert made.down_dims == SIZES["simple"]
    assert made.drop_n_last_frames == 7
    assert made.observation_delta_indices == [-1, 0]
    assert made.action_delta_indices == list(range(-1, 15))


def test_the_papers_size_is_dp3s():
    policy = DP3Policy(config(size="paper", down_dims=None, diffusion_step_embed_dim=128))
    assert 2.5e8 < sum(weight.numel() for weight in policy.model.parameters()) < 2.7e8


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
    def forward(self, step):
        half = 8
        angles = step[:, None] * torch.exp(torch.arange(half) * -(math.log(10000) / (half - 1)))[None]
        return torch.cat([angles.sin(), angles.cos()], dim=-1)


class OriginalUnet(nn.Module):
    def __init__(self, actions: int, condition: int) -> None:
        super().__init__()
        a, b, embed = 16, 32, 16
        c = condition + embed
        self.diffusion_step_encoder = nn.Sequential(
            Sinusoids(), nn.Linear(embed, 4 * embed), nn.Mish(), nn.Linear(4 * embed, embed)
        )
        self.mid_modules = nn.ModuleList([Residual(b, b, c), Residual(b, b, c)])
        down = Wrapped(nn.Conv1d(a, a, 3, 2, 1)), nn.Identity()
        self.down_modules = nn.ModuleList(
            nn.ModuleList([Residual(before, after, c), Residual(after, after, c), layer])
            for before, after, layer in ((actions, a, down[0]), (a, b, down[1]))
        )
        up = Wrapped(nn.ConvTranspose1d(a, a, 4, 2, 1))
        self.up_modules = nn.ModuleList([nn.ModuleList([Residual(2 * b, a, c), Residual(a, a, c), up])])
        self.final_conv = nn.Sequential(Conv(a, a, 5), nn.Conv1d(a, actions, 1))

    def forward(self, sample, step, condition):
        condition = torch.cat([self.diffusion_step_encoder(step), condition], dim=-1)
        x, kept = sample.transpose(1, 2), []
        for first, second, halve in self.down_modules:
            x = second(first(x, condition), condition)
            kept.append(x)
            x = halve(x)
        for middle in self.mid_modules:
            x = middle(x, condition)
        for first, second, double in self.up_modules:
            x = torch.cat([x, kept.pop()], dim=1)
            x = double(second(first(x, condition), condition))
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


class Original(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.obs_encoder, self.model = OriginalEncoder(), OriginalUnet(JOINTS, 256)
        self.normalizer = nn.Linear(1, 1)  # left out


def test_weights_of_the_original_fit_by_their_names_and_act_alike():
    torch.manual_seed(2)
    original, policy = Original(), DP3Policy(config())
    policy.model.load_state_dict(from_original(original.state_dict()), strict=True)
    batch, noisy, step = windows(), torch.randn(4, 16, JOINTS), torch.tensor([0, 10, 50, 99])
    with torch.no_grad():
        features = original.obs_encoder(batch[CLOUD].flatten(0, 1), batch[OBS_STATE].flatten(0, 1)).reshape(4, -1)
        condition = policy.model._prepare_global_conditioning(batch)
        torch.testing.assert_close(condition, features)
        torch.testing.assert_close(
            policy.model.unet(noisy, step, global_cond=condition), original.model(noisy, step, features)
        )
