#!/usr/bin/env bash
# From a converted dataset to a trained and evaluated policy, with LeRobot's own scripts and nothing else.
# run: bash examples/07_train_and_evaluate.sh [FOLDER [DEMONSTRATIONS [STEPS [TRIALS]]]]   (FOLDER must not exist)
# The defaults show that everything works, in three minutes; to learn it takes some 50 demonstrations and 12000 steps, half an hour
# on one core, with which `cei-benchmark` trains.
set -euo pipefail
folder=${1:-outputs/example-policy} demonstrations=${2:-4} steps=${3:-20} trials=${4:-2}
mkdir -p "$(dirname "$folder")"
mkdir "$folder"

cei-record --env=CEI-PickCube-Panda-PandaGripper --episodes="$demonstrations" --seed=0 --variation=0.25 \
  --repo_id=me/pick_cube_panda --root="$folder/panda"

cei-convert --dataset.repo_id=me/pick_cube_panda --dataset.root="$folder/panda" --target=UR5e-FourierRight \
  --new_repo_id=me/pick_cube_ur5e --new_root="$folder/ur5e"

lerobot-train --dataset.repo_id=me/pick_cube_ur5e --dataset.root="$folder/ur5e" \
  --policy.type=dp3 --policy.size=small "--policy.cloud_channels=[32,64,128]" --policy.n_obs_steps=1 --policy.horizon=8 \
  --policy.state_noise=0.1 --policy.push_to_hub=false \
  --policy.optimizer_lr=1e-3 --policy.scheduler_warmup_steps=200 \
  --batch_size=32 --steps="$steps" --save_freq="$steps" --num_workers=0 --output_dir="$folder/train"

lerobot-eval --policy.path="$folder/train/checkpoints/last/pretrained_model" \
  --env.type=cei --env.dataset="$folder/ur5e" \
  --eval.n_episodes="$trials" --eval.batch_size=2 --seed=1000 --output_dir="$folder/eval"
