#!/usr/bin/env bash
# A real Panda with a spatula, as DemoGen publishes it (zarr, end-effector poses, clouds with colours), becomes a UR5e with an Inspire hand.
# Usage: examples/09_real_clouds.sh <demogen_egg.zarr>
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
source=${1:?the zarr folder}

cei-convert --dataset.repo_id=demogen/egg --dataset.root="$source" --joint_map="$here/egg/joint_map.yaml" \
    --target=UR5e-Inspire --new_repo_id=me/egg --new_root=outputs/egg

cei-view --dataset.repo_id=me/egg --dataset.root=outputs/egg \
    --source.repo_id=demogen/egg --source.root="$source" --source.joint_map="$here/egg/joint_map.yaml" --sheet=outputs/egg.png
