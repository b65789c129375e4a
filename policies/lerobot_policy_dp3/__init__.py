"""3D Diffusion Policy (Ze et al., 2024) as a LeRobot policy: `--policy.type=dp3`. LeRobot imports this by itself."""

from lerobot_policy_dp3.configuration_dp3 import DP3Config
from lerobot_policy_dp3.fast_reader import install
from lerobot_policy_dp3.modeling_dp3 import DP3Policy
from lerobot_policy_dp3.processor_dp3 import make_dp3_pre_post_processors

__all__ = ["DP3Config", "DP3Policy", "make_dp3_pre_post_processors"]

install()
