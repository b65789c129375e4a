"""An end-effector of your own on a catalogued arm: load its YAML, build the embodiment, look at its pads.

run: python examples/04_your_own_hand.py
"""

from pathlib import Path

from PIL import Image

from cei_gym.embodiment import EndEffectorSpec, build_embodiment, load_arm, load_spec
from cei_gym.functional import sample_representation
from cei_gym.functional.picture import draw_representation

here = Path(__file__).parent
hand = load_spec(EndEffectorSpec, here / "04_your_own_hand.yaml")
embodiment = build_embodiment(load_arm("UR5e"), hand, relative_to=here)
representation = sample_representation(embodiment, points=64, seed=0)

print(f"{embodiment.name}: {len(embodiment.joint_names)} joints, {len(embodiment.coupled.independent)} independent")
print(f"{len(representation)} points with normals on {len(set(representation.body))} pads")
Path("outputs").mkdir(exist_ok=True)
Image.fromarray(draw_representation(representation, embodiment.home)).save("outputs/your_own_hand.png")
print("wrote outputs/your_own_hand.png")
