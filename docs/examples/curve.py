"""Plot success over training steps: python curve.py TRAINING STEPS=RUN STEPS=RUN ..."""

import sys
import tomllib
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

import minitouch_bench as mt

training, *runs = sys.argv[1:]
task = tomllib.loads(Path(training, "config.toml").read_text())["task"]
rows = pd.read_csv(f"{training}/progress.csv")
won = (rows["success"] * rows["episodes"]).fillna(0)  # of the episodes since the row before
smooth = won.rolling(10, min_periods=1).sum() / rows["episodes"].rolling(10, min_periods=1).sum()
plt.plot(rows["step"], smooth, label="training episodes, over ten rows")
for steps, directory in (run.split("=", 1) for run in runs):
    one = mt.load_run(directory)[task].success
    interval = [[one.value - one.low], [one.high - one.value]]
    plt.errorbar(int(steps), one.value, interval, color="black", marker="o")
plt.xlabel("control steps")
plt.ylabel("success, 95 % interval over episodes")
plt.legend()
plt.savefig("curve.png")
