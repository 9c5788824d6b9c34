"""Cut a recording into a part to fit traffic with and a part to test it with.

Its windows (docs/realism.md) are taken in the order A B B A A B B A ...: A to fit, B to test. So both parts have early
and late windows alike. Writes FOLDER/fit.parquet and FOLDER/test.parquet, which `cosim realism --fit --test` and
`cosim calibrate --fit` read.

    python benchmarks/split_recording.py us-101.csv.gz FOLDER
"""

import argparse
from pathlib import Path

from cosim.studies.observation_windows import windows_of
from cosim.studies.traffic_samples import COLUMNS, recorded_samples

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("recording", type=Path)
parser.add_argument("folder", type=Path)
given = parser.parse_args()
given.folder.mkdir(parents=True, exist_ok=True)
windows, samples = windows_of(recorded_samples(given.recording))
fit = samples["window"].mod(4).isin([0, 3])
for name, chosen in (("fit", fit), ("test", ~fit)):
    part = samples[chosen]
    part = part.assign(source=part["source"] + "/" + part["window"].astype(str))[list(COLUMNS)]
    part.to_parquet(given.folder / f"{name}.parquet")
    print(f"{name}: {part['source'].nunique()} of {len(windows)} windows, {len(part)} samples")
