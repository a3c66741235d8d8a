"""Damage of bundled data is named with its file."""

import pytest
from texts import changed_text

from gauge_envs.errors import ReferenceFileError
from gauge_envs.references.band import bundled_band
from gauge_envs.references.deformation import bundled_deformation
from gauge_envs.references.published import law_for, published_variants
from gauge_envs.scoring.reference import load_band

RESULTS, LAWS = "published/engine_results.csv", "bands/laws.toml"
BAND, SIDECAR = "bands/SlopeSlider-2-wood.csv", "bands/SlopeSlider-2-wood.toml"
SEEN, SEEN_SIDECAR = "bands/SlopeContact-wood.csv", "bands/SlopeContact-wood.toml"
BENT, BENT_SIDECAR = (
    "statistics/FoamBending-soft.csv",
    "statistics/FoamBending-soft.toml",
)


def load(file):
    """Read a file as the package does."""
    folder, name = file.parts[-2:]
    if folder == "published":
        return published_variants()
    if name == "laws.toml":
        return law_for("SlopeSlider-1-wood")
    if folder == "statistics":
        return bundled_deformation(file.stem)
    return bundled_band(file.stem)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (RESULTS, "variant,frames", "variant,frame", "line 1: columns are"),
        (RESULTS, "5.17", "5.l7", "line 2: baseline_std: "),
        (RESULTS, "10,dtw", "ten,dtw", "line 3: frames: "),
        (RESULTS, "wood,10,dtw", "wood,10,rmse", "SlopeContact-wood has a second row"),
        (RESULTS, "10,dtw", "10,dwt", "line 3: metric: 'dwt' is none of rmse, dtw"),
        (RESULTS, "9.25", "", "line 2: baseline_mean: "),
        (RESULTS, ",2.98", "", "line 2: 8 fields, expected 9"),
        (BAND, "\n3,", "\n4,", "line 5: frame 4 where 3 is next"),
        (BAND, "-96.678904", "nan", "line 3: mean.downhill: "),
        (BAND, ",0,3,", ",2,3,", "line 7: measured: "),
        (BAND, "0.817780", "-0.817780", "line 2: sigma.downhill: "),
        (SIDECAR, '"trials"', '"guess"', "grade: "),
        (SIDECAR, "trial_count = 20", "", "grade 'trials' needs trial_count"),
        (SIDECAR, "[0.866025403784,", '["x",', "projection.0.0: "),
        (SIDECAR, 'unit = "mm"', 'unit = "mm', "at line 4"),
        (LAWS, 'kind = "carried"', 'kind = "thrown"', "law.0: "),
        (LAWS, 'carrier = "board"', "", "law.0.carried.carrier: missing key"),
        (LAWS, "sigma_mm = 1.0", "sigma_mm = 0.0", "sigma_mm: "),
        (SEEN, "mean.slide", "mean.slid", "line 1: columns are"),
        (SEEN, "measured,mean.", "measured,average.", "expected mean.slide among them"),
        (SEEN, ",1.58", ",-1.58", "line 2: uncertainty.slide: "),
        (SEEN, ",1.58", ",x", "line 2: uncertainty.slide: "),
        (SEEN_SIDECAR, "frames = 10", "frames = 4", "4, but the table has 7"),
        (SEEN_SIDECAR, "sigma = 6", "sigmas = 6", "sigmas: unknown key"),
        (SEEN_SIDECAR, "sigma = ", "# ", "sigma is missing here, and the table"),
        (SEEN_SIDECAR, '"baseline"', '"guess"', "sigma_source: "),
        (SEEN_SIDECAR, "withheld = ", "withheld = 3 #", "withheld: "),
        (SEEN_SIDECAR, 'coordinates = ["slide"]', "", "coordinates: missing key"),
        ("bands/FoamBending-soft.toml", "11]", "12]", "whole numbers from 0 to 11"),
        ("bands/FoamBending-soft.toml", "width = 12", "", "indices and width"),
        (BENT, "mean.strain.yy", "mean.strain.y", "line 1: columns are"),
        (BENT, "\n1,", "\n2,", "line 3: frame 2 where 1 is next"),
        (BENT, "0.0266", "-0.0266", "uncertainty.strain.yy: "),
        (BENT_SIDECAR, "frames = 35", "frames = 5", "5, but the table has 35"),
        (BENT_SIDECAR, '"statistics"', '"trials"', "grade: "),
        (BENT_SIDECAR, "trial_count = 1", "", "trial_count: missing key"),
    ],
)
def test_a_damaged_file_is_named(scoring, file, old, new, message):
    damaged = changed_text(scoring / file, (old, new))
    with pytest.raises(ReferenceFileError) as caught:
        load(damaged)
    assert str(damaged) in str(caught.value)
    assert message in str(caught.value)


def test_a_band_without_its_sidecar_is_damage(scoring):
    (scoring / SIDECAR).unlink()
    with pytest.raises(ReferenceFileError, match=r"wood\.toml: the file is missing"):
        load_band("SlopeSlider-2-wood")


def test_a_measured_sigma_needs_an_uncertainty(scoring):
    changed_text(scoring / SEEN_SIDECAR, ('"baseline"', '"measurement"'))
    (scoring / SEEN).write_text("frame,time_s,measured,mean.slide\n0,0.0,1,5\n")
    with pytest.raises(ReferenceFileError, match="the table has no uncertainty"):
        bundled_band("SlopeContact-wood")
