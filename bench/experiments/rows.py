"""The rows of the tables: which system runs, with which settings."""

from __future__ import annotations

from dataclasses import dataclass

# The sessions that a row maps are recorded once: by FAST-LIO2 as published for all rows but one.
SHARED = "fast_lio2"
OWN = "own"


@dataclass(frozen=True)
class Row:
    """A back end, and the recording of odometry that it reads."""

    name: str
    definition: str
    settings: tuple[str, ...] = ()  # of `chainslam map`; of LAMM its options
    odometry: str = SHARED
    program: str = "chainslam"
    of_platform: tuple[tuple[str, tuple[str, ...]], ...] = ()  # more settings, by platform

    def settings_on(self, platform: str) -> tuple[str, ...]:
        return self.settings + dict(self.of_platform).get(platform, ())

    @property
    def is_published(self) -> bool:
        """A published system, or its settings, which changes of the default preset do not concern."""
        return self.program == "lamm" or self.settings[:1] in (PAPER, RELEASED)

    @property
    def is_front_end(self) -> bool:
        return self.name == "fast-lio2"


PAPER = ("preset=paper",)
RELEASED = ("preset=released",)
UNCHAINED = ("chain.enabled=false",)

MAIN_ROWS = (
    Row(
        "fast-lio2",
        "front end alone: FAST-LIO2 as published; no closures, no merges, every session under an alignment of its own",
        PAPER + ("closures.radius=0", "merge.enabled=false"),
    ),
    Row("lamm", "LAMM as designed, on the same odometry", program="lamm"),
    Row("lamm-as-released", "LAMM as its code does it", ("--as-released",), program="lamm"),
    Row("unchained", "preset=paper without chained closures", PAPER + UNCHAINED),
    Row("chained", "preset=paper: Chain-SLAM as published", PAPER),
    Row("released", "preset=released: Chain-SLAM as its code does it", RELEASED),
    Row("best-unchained", "the default preset without chained closures", UNCHAINED),
    Row("best", "the default preset, on FAST-LIO2's odometry as all rows"),
)
# By its name alone: its odometry takes several times as long as FAST-LIO2's, and nothing else reads it.
OWN_ROW = Row("best-own", "the default preset on its own front end's odometry", odometry=OWN)

# What `best` does otherwise than `paper`, by subject: prefixes of settings. Together they must cover every setting of
# the back end in which the two differ; see `ablations`.
SUBJECTS: dict[str, tuple[str, ...]] = {
    "keyframes": ("keyframes.",),
    "registration": (
        "closures.method",
        "closures.max_distance",
        "closures.max_iterations",
        "closures.coarse_stride",
        "closures.min_overlap",
        "closures.degeneracy_threshold",
        "closures.translation_tolerance",
        "closures.rotation_tolerance",
        "closures.cost_tolerance",
        "closures.scan_voxel",
        "closures.voxel_size",
        "closures.submap_radius",
        "closures.submap_length",
        "closures.submap_fragment",
    ),
    "gates": (
        "closures.accept_iteration_limit",
        "closures.max_mean_squared_error",
        "closures.max_misfit",
        "closures.min_inlier_ratio",
        "closures.max_translation",
        "closures.max_rotation",
    ),
    "closure-noise": ("closures.noise_from_hessian", "closures.lambda", "closures.min_variance"),
    "outliers": ("closures.outlier_threshold", "graph.odometry_outlier_threshold"),
    "gnss": ("graph.gnss",),
    "gravity": ("graph.gravity",),
    "search-again": ("closures.search_again",),
    "optimization": ("closures.at_once",),
    "candidates": (
        "closures.radius",
        "closures.start_",
        "closures.max_candidates",
        "closures.max_places",
        "closures.heading_weight",
        "closures.min_interval",
        "closures.min_keyframes",
        "closures.max_alignments",
        "closures.before_merge",
    ),
    "search-spacing": ("closures.min_travel", "closures.min_period"),
    "chain-reach": ("chain.reach", "chain.through_current_session"),
    "chain-guess": ("chain.guess_through_chain",),
    "chain-bounds": ("chain.max_distance", "chain.min_separation", "chain.max_alignments"),
    "chain-contradiction": ("chain.max_translation", "chain.max_rotation"),
    "chain-correlation": ("chain.correlation",),
    "merge-candidates": ("merge.gnss_", "merge.max_candidates", "merge.max_places", "merge.place_", "merge.min_travel", "merge.min_period"),
    "merge-registration": (
        "merge.method",
        "merge.submap_",
        "merge.voxel_size",
        "merge.normal_",
        "merge.feature_",
        "merge.edge_length_ratio",
        "merge.max_distance",
        "merge.max_iterations",
        "merge.confidence",
        "merge.min_",
    ),
    "merge-confirmation": ("merge.confirmations", "merge.min_place_distance", "merge.supporting_scans", "merge.max_fix_difference", "merge.misplaced"),
    "merge-factor": ("merge.measurement", "merge.lambda"),
    "merge-chaining": ("merge.chained", "merge.recheck_"),
    "odometry-noise": ("graph.odometry_",),
    "anchors": ("graph.anchor", "graph.remeasure_loaded"),
}
BACK_END = ("keyframes.", "closures.", "chain.", "merge.", "graph.")


class RowError(Exception):
    """There is no such row, or settings and rows do not go together."""


def subject_of(key: str) -> str:
    """The subject that a setting belongs to: that with the longest prefix of its name."""
    found = [(len(prefix), subject) for subject, keys in SUBJECTS.items() for prefix in keys if key.startswith(prefix)]
    if not found:
        raise RowError(f"no subject of rows.py has the setting {key}, in which best and paper differ: add it to one")
    return max(found)[1]


def differing(best: dict[str, str], paper: dict[str, str]) -> dict[str, tuple[str, ...]]:
    """By subject the paper's values of the settings in which the two presets differ."""
    found: dict[str, tuple[str, ...]] = {}
    for key, value in best.items():
        if key.startswith(BACK_END) and paper[key] != value:
            subject = subject_of(key)
            found[subject] = (*found.get(subject, ()), f"{key}={paper[key]}")
    return found


def ablations(presets: dict[str, tuple[dict[str, str], dict[str, str]]]) -> list[Row]:
    """One row for each subject: `best` with what `paper` does there.

    @param presets  by platform all settings of best and of paper, as `chainslam config --print` writes them.
    """
    by_platform = {platform: differing(*pair) for platform, pair in presets.items()}
    rows = []
    for subject in SUBJECTS:
        values = {platform: found[subject] for platform, found in by_platform.items() if subject in found}
        if not values:
            continue
        text = "; ".join(f"{platform}: {', '.join(words)}" for platform, words in values.items())
        if len(set(values.values())) == 1 and len(values) == len(presets):
            text = ", ".join(next(iter(values.values())))
        rows.append(Row(f"ablation-{subject}", f"best with the paper's {subject}: {text}", of_platform=tuple(values.items())))
    return rows


def chosen(names: list[str], ablation_rows: list[Row]) -> list[Row]:
    """Rows by their names; `main` and `ablations` stand for several, and nothing for `main`."""
    rows: list[Row] = []
    known = {row.name: row for row in (*MAIN_ROWS, OWN_ROW, *ablation_rows)}
    for name in names or ["main"]:
        if name == "main":
            rows += MAIN_ROWS
        elif name == "ablations":
            rows += [known["best"], *ablation_rows]
        elif name in known:
            rows.append(known[name])
        else:
            raise RowError(f"there is no row {name}; rows: main, ablations, {', '.join(known)}")
    return list(dict.fromkeys(rows))
