"""Find out what the model of a rig lacks, from Python; takes half a minute or so."""

from pathlib import Path

from pam_antagonist import diagnose

folder = Path(__file__).parent / "recordings"
found = diagnose([folder / "leak_free", folder / "leak_locked"], "shin2022", profiles=False, estimator=False)

print(found.verdict, "-", found.sentence)
for effect in found.effects:
    print(f"{effect.name}, muscle {effect.muscle}, ΔBIC {effect.delta_bic:.0f}")
    for name, (value, std, unit) in effect.parameters.items():
        print(f"  {name} {value:.3g} ± {std:.2g} {unit}")
