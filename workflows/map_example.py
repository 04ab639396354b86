# A map of 16 points from Python only: nickel on stainless steel, four sizes, four velocities.
#
# Run it as a whole, python workflows/map_example.py, or cell by cell in an editor with cells (`# %%`). It takes a few minutes; what
# has been computed is kept in runs/map_example and not computed again.

# %% The points: every combination of these is a run of its own
from coupler.studies.sweep import Sweep

sweep = Sweep.from_dict(
    {
        "name": "map_example",
        "points": {
            "material": ["Ni"],
            "diameter": ["10 um", "16 um", "25 um", "40 um"],
            "velocity": ["300 m/s", "450 m/s", "650 m/s", "900 m/s"],
            "temperature": ["300 K"],
        },
        "scene": {"preset": "draft", "substrate": {"material": "SS304"}},
    }
)
print(len(sweep.points), "points, the first:", next(iter(sweep.points)))

# %% Run them, one at a time; `jobs=4` on a machine with four free cores
folder = sweep.run()

# %% What came out: a list of rows, one for each point, in SI units
from coupler.studies.maps import interpolate  # noqa: E402
from coupler.studies.runs_table import table  # noqa: E402

rows = table(folder)
for row in rows:
    if row["status"] == "done":
        print(
            f"{row['diameter_m'] * 1e6:3.0f} um {row['velocity_m_s']:4.0f} m/s   flattening {row['flattening_ratio']:.3f}"
            f"   {row['T_p99_K']:4.0f} K   v / v_crit {row['velocity_ratio']:.2f}"
        )
    else:
        print(row["point"], row["status"], row["reason"])

# %% Between the points: a Gaussian process, with its uncertainty and how well it predicts a point that is left out
flattening = interpolate(rows, "flattening_ratio")
print(f"leaving one out: {flattening.loo_rms:.3f} rms, of a spread of {flattening.spread:.3f}")
mean, std = flattening(550.0, 25e-6)  # m/s, m: in the order of flattening.axes
print(f"25 um at 550 m/s: {mean:.3f} +- {1.96 * std:.3f} (95 %)")

# %% One run by itself: any field at any stored step
from coupler import Result  # noqa: E402

result = Result(folder / "Ni_25um_650ms_300K")
hottest = result.fields(-1).data["T"].max()
print(f"25 um at 650 m/s: rebound {result.rebound_velocity_m_s:.0f} m/s, hottest point {hottest:.0f} K")

# %% Maps as pictures, as `coldspray map runs/map_example` draws them
from coupler.studies.map_figures import draw  # noqa: E402

for line in draw(rows, folder, ["flattening_ratio", "T_p99_K"]):
    print(line)
