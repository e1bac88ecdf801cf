"""LeRobot imports this package before it reads its command line; importing registers our types.

lerobot-train --policy.type=attention_diffusion ...
lerobot-eval --policy.path=RUN/checkpoints/cpu/last/pretrained_model --env.type=codediffuser
"""

from codediffuser.training.lerobot_env import CodediffuserEnv
from codediffuser.training.policies.attention_diffusion import AttentionDiffusionConfig

__all__ = ["AttentionDiffusionConfig", "CodediffuserEnv"]
