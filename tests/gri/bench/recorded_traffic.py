"""Generated traffic in the layout of the official files, in which each vehicle repeats the speed of the one ahead."""

from pathlib import Path

import numpy as np
import pandas as pd

from tests.gri.data.ngsim.conftest import CLOCK, as_text, platoon

FRAMES = 110


def waves(platoons: int = 30, reacts: bool = True) -> pd.DataFrame:
    """Platoons of three, each at its time, or each vehicle with a wave of its own."""
    generator, tables = np.random.default_rng(0), []
    for which in range(platoons):
        table = platoon(3, FRAMES, first_id=100 * (which % 10) + 3 * (which // 10), clock=CLOCK + 10**5 * which)
        phase, rate = generator.uniform(0, 6.3, (3, 3)), generator.uniform(0.5, 2.0, (3, 3))
        if reacts:
            phase, rate = phase[[0, 0, 0]], rate[[0, 0, 0]]
        for k, (_, rows) in enumerate(table.groupby("Vehicle_ID").groups.items()):
            time = 0.1 * table.loc[rows, "Frame_ID"] - 0.9 * (2 - k)
            wave = np.outer(time, rate[k]) + phase[k]
            table.loc[rows, "Local_Y"] += (3.0 / rate[k] * np.sin(wave)).sum(1)
            table.loc[rows, "v_Vel"] += 3.0 * np.cos(wave).sum(1)
        tables.append(table)
    return pd.concat(tables)


def waves_file(folder: Path, reacts: bool = True) -> Path:
    return as_text(waves(reacts=reacts), folder / "us-101.txt")
