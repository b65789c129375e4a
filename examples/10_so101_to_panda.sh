#!/usr/bin/env bash
# Demonstrations of an SO-101, LeRobot's own low-cost arm, become a Panda's. Its gripper is one moving jaw on the arm's last link.
# Usage: examples/10_so101_to_panda.sh <folder with so101_pick> <folder with so101_new_calib.urdf and its assets> [target]
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
source=${1:?the folder of the dataset, which holds meta/ and data/}
robot=${2:?the folder of the description: Simulation/SO101 of TheRobotStudio/SO-ARM100}
target=${3:-Panda-PandaGripper}
own=$(mktemp -d) # robots of one's own, beside their description
trap 'rm -rf "$own"' EXIT
cp -r "$here/so101" "$own/embodiments"
cp -r "$robot" "$own/embodiments/robot"
export CEI_GYM_EMBODIMENTS=$own/embodiments

cei-inspect --dataset.repo_id=lab/so101 --dataset.root="$source" --joint_map="$here/so101/joint_map.yaml"

# --target_pose: 30 cm behind where the SO-101 stands, which reaches half as far.
cei-convert --dataset.repo_id=lab/so101 --dataset.root="$source" --joint_map="$here/so101/joint_map.yaml" \
    --target="$target" --target_pose=-0.3,0,0 --new_repo_id=me/so101 --new_root=outputs/so101

cei-view --dataset.repo_id=me/so101 --dataset.root=outputs/so101 --source.repo_id=lab/so101 --source.root="$source" \
    --source.joint_map="$here/so101/joint_map.yaml" --sheet=outputs/so101.png
