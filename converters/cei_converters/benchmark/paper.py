"""The paper's figures: percent of demonstrations that succeed when replayed, of trials of policies, and trials on real robots."""

from cei_gym.embodiment import ARMS

REPLAY: dict[str, dict[str, dict[str, int]]] = {
    "OpenDrawer": {
        "FourierRight": dict(zip(ARMS, (100, 100, 100, 100), strict=True)),
        "Inspire": dict(zip(ARMS, (91, 87, 87, 84), strict=True)),
        "FourierLeft": dict(zip(ARMS, (100, 96, 98, 100), strict=True)),
        "RobotiqThreeFinger": dict(zip(ARMS, (78, 91, 93, 93), strict=True)),
    },
    "PickCube": {
        "FourierRight": dict(zip(ARMS, (81, 72, 69, 79), strict=True)),
        "Inspire": dict(zip(ARMS, (50, 45, 33, 43), strict=True)),
        "FourierLeft": dict(zip(ARMS, (88, 83, 81, 79), strict=True)),
        "RobotiqThreeFinger": dict(zip(ARMS, (19, 31, 41, 52), strict=True)),
    },
    "StackCube": {
        "FourierRight": dict(zip(ARMS, (53, 38, 37, 34), strict=True)),
        "Inspire": dict(zip(ARMS, (24, 16, 12, 15), strict=True)),
        "FourierLeft": dict(zip(ARMS, (57, 47, 50, 47), strict=True)),
        "RobotiqThreeFinger": dict(zip(ARMS, (0, 0, 5, 9), strict=True)),
    },
}
"""Its table of replays: task, end-effector, arm."""

ABLATION_TARGETS = ("UR5e-FourierRight", "IIWA-Inspire", "Kinova3-FourierLeft", "Panda-RobotiqThreeFinger")
ABLATION = {
    "OpenDrawer": {"BMS": (80, 92, 87, 64), "without direction": (84, 100, 91, 100), "CEI": (100, 87, 98, 93)},
    "PickCube": {"BMS": (0, 0, 0, 0), "without direction": (7, 2, 0, 0), "CEI": (81, 45, 81, 52)},
    "StackCube": {"BMS": (0, 0, 0, 0), "without direction": (0, 0, 0, 0), "CEI": (53, 16, 50, 9)},
}
"""Its ablation: task, method, one figure a target."""

SENSITIVITY_TASK, SENSITIVITY_END_EFFECTOR = "PickCube", "FourierRight"
SENSITIVITY = {"standard": 85, "reduced": 90, "randomly dropped": 80}
"""Its sensitivity to the representation: 17, 18 and 16 of 20. It does not name the arm."""

POLICY_TARGETS = ABLATION_TARGETS
POLICY = {
    "OpenDrawer": {
        "no_augmentation": (0, 0, 0, 0),
        "no_inference_augmentation": (100, 79, 32, 64),
        "cei": (100, 90, 100, 90),
    },
    "PickCube": {
        "no_augmentation": (0, 0, 0, 0),
        "no_inference_augmentation": (42, 26, 38, 10),
        "cei": (79, 68, 68, 23),
    },
    "StackCube": {
        "no_augmentation": (0, 0, 0, 0),
        "no_inference_augmentation": (36, 10, 44, 0),
        "cei": (55, 16, 52, 0),
    },
}
"""Its table of policies: task, variant, one figure a target."""

REAL_TRIALS = 10
REAL = {
    "PushCube": (10, 10),
    "OpenDrawer": (8, 10),
    "PlaceBird": (7, 10),
    "PickCup": (6, 8),
    "PackageBread": (9, 9),
    "InsertFlower": (2, 4),
}
"""Its table of policies on real robots: of `REAL_TRIALS`, how many succeed on the target, and how many of the source's own on the source."""
MODES = {"pattern_1": 8, "pattern_2": 7, "mixture": 7}
"""Its table of OpenDrawer's two motions: policies' successes of `REAL_TRIALS`."""
