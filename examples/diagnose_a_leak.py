"""Find out what the model of a rig lacks, from Python; takes half a minute or so."""

from pathlib import Path

from pam_antagonist.diagnosis import diagnose
from pam_antagonist.recording import read_bag
from pam_antagonist.rig import load_rig

folder = Path(__file__).parent / "recordings"
recordings = [read_bag(folder / name) for name in ("leak_free", "leak_locked")]
found = diagnose(recordings, load_rig("shin2022"), profiles=False, estimator=False)

print(found.verdict, "-", found.sentence)
for effect in found.effects:
    print(f"{effect.name}, muscle {effect.muscle}, ΔBIC {effect.delta_bic:.0f}")
    for name, (value, std, unit) in effect.parameters.items():
        print(f"  {name} {value:.3g} ± {std:.2g} {unit}")
