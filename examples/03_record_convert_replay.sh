#!/usr/bin/env bash
# The main job by hand, on three demonstrations: record on a Panda, convert to a UR5e with a Fourier hand, replay.
# run: bash examples/03_record_convert_replay.sh [FOLDER]   (FOLDER must not exist)
set -euo pipefail
folder=${1:-outputs/example}
mkdir -p "$(dirname "$folder")"
mkdir "$folder"

cei-record --env=CEI-PickCube-Panda-PandaGripper --episodes=3 --seed=0 \
  --repo_id=me/pick_cube_panda --root="$folder/panda"

cei-convert --dataset.repo_id=me/pick_cube_panda --dataset.root="$folder/panda" --target=UR5e-FourierRight \
  --new_repo_id=me/pick_cube_ur5e --new_root="$folder/ur5e"

cei-replay --dataset.repo_id=me/pick_cube_ur5e --dataset.root="$folder/ur5e" \
  --source.repo_id=me/pick_cube_panda --source.root="$folder/panda" \
  --video="$folder/side_by_side.mp4" --json="$folder/replay.json"
