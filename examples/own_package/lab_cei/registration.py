"""What is registered; quick to import, as every `import cei_gym` does."""

from cei_envs.registration import Task

TOUCH_CUBE = Task(
    "TouchCube",
    environment="lab_cei.task:TouchCubeEnv",
    experts={"Panda-PandaGripper": "lab_cei.task:TouchCubeExpert"},
    max_episode_steps=200,
)
