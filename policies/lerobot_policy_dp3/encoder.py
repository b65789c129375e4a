"""What an observation becomes before it conditions the diffusion: PointNet over the cloud, an MLP over the state."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class PointNet(nn.Module):
    """The same layers for each point, then the largest of each channel over all points.

    Args:
        in_channels: 3, or 6 with colours.
        channels: of the layers; as in DP3, with colours (four layers) the last one is only linear.
        out_features: of the projection.
    """

    def __init__(self, in_channels: int, channels: Sequence[int], out_features: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in zip([in_channels, *channels[:-1]], channels, strict=True):
            layers += [nn.Linear(before, after), nn.LayerNorm(after), nn.ReLU()]
        self.mlp = nn.Sequential(*(layers[:-2] if len(channels) > 3 else layers))
        self.final_projection = nn.Sequential(nn.Linear(channels[-1], out_features), nn.LayerNorm(out_features))

    def forward(self, points: Tensor) -> Tensor:
        """(B, N, in_channels) to (B, out_features)."""
        if torch.is_grad_enabled():
            points = self._largest(points)
        return self.final_projection(self.mlp(points).max(dim=1).values)

    @torch.no_grad()
    def _largest(self, points: Tensor) -> Tensor:
        """(B, M, in_channels) the points that are largest in some channel, about one in ten.

        No gradient reaches the others, so training looks at these alone: the same gradient, in less than half the time.
        """
        chosen = self.mlp(points).max(dim=1).indices
        is_chosen = torch.zeros(points.shape[:2], device=points.device).scatter_(1, chosen, 1.0)
        # Clouds with fewer are filled up with others of their points, which change nothing.
        most = int(is_chosen.sum(dim=1).max())
        which = is_chosen.topk(most, dim=1).indices
        return points.gather(1, which.unsqueeze(-1).expand(-1, -1, points.shape[-1]))


class ObservationEncoder(nn.Module):
    """The features of one observation, the cloud's and then the state's.

    Args:
        in_channels, channels, cloud_features: of the PointNet.
        state_dim: of the state.
        state_channels: of the two layers of its MLP.
    """

    def __init__(
        self,
        in_channels: int,
        channels: Sequence[int],
        cloud_features: int,
        state_dim: int,
        state_channels: tuple[int, int],
    ) -> None:
        super().__init__()
        hidden, out = state_channels
        self.extractor = PointNet(in_channels, channels, cloud_features)
        self.state_mlp = nn.Sequential(nn.Linear(state_dim, hidden), nn.ReLU(), nn.Linear(hidden, out))
        self.out_features = cloud_features + out

    def forward(self, points: Tensor, state: Tensor) -> Tensor:
        """(B, N, in_channels) and (B, state_dim) to (B, out_features)."""
        return torch.cat([self.extractor(points), self.state_mlp(state)], dim=-1)
