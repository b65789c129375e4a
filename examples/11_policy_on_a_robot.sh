#!/usr/bin/env bash
# The whole way to a robot, with LeRobot's own scripts: record, convert, train, see what the robot must offer, roll out.
# The robot is a simulated one (examples/simulated_robot) whose joints are in another order and in degrees; yours takes its place.
# run: bash examples/11_policy_on_a_robot.sh [FOLDER [DEMONSTRATIONS [STEPS [SECONDS]]]]   (FOLDER must not exist)
set -euo pipefail
folder=${1:-outputs/example-robot} demonstrations=${2:-4} steps=${3:-20} seconds=${4:-5}
mkdir -p "$(dirname "$folder")"
mkdir "$folder"
policy="$folder/train/checkpoints/last/pretrained_model"

cei-record --env=CEI-PickCube-Panda-PandaGripper --episodes="$demonstrations" --seed=0 --variation=0.25 \
  --repo_id=me/pick_cube_panda --root="$folder/panda"

cei-convert --dataset.repo_id=me/pick_cube_panda --dataset.root="$folder/panda" --target=IIWA-Inspire \
  --new_repo_id=me/pick_cube_iiwa --new_root="$folder/iiwa"

lerobot-train --dataset.repo_id=me/pick_cube_iiwa --dataset.root="$folder/iiwa" \
  --policy.type=dp3 --policy.size=small --policy.points=256 "--policy.cloud_channels=[32,64,128]" --policy.push_to_hub=false \
  --batch_size=16 --steps="$steps" --save_freq="$steps" --num_workers=0 --output_dir="$folder/train"

cei-deploy --policy="$policy"

# At the end: "From observation to action: ... ms". The simulated robot waits for its joints by itself; for yours, see what cei-deploy has said of --robot.wait_s.
PYTHONPATH="$(dirname "$0")" lerobot-rollout --policy.path="$policy" --fps=20 --duration="$seconds" --device=cpu \
  --play_sounds=false --return_to_initial_position=false \
  --robot.type=cei --robot.trained_on="$policy" --robot.unit=deg --robot.discover_packages_path=simulated_robot \
  --robot.robot="{\"type\": \"simulated\", \"env\": \"CEI-PickCube-IIWA-Inspire\", \"stands_at\": \"$folder/iiwa\"}"
