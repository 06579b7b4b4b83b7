"""Where everything lies under `results/<run>/`; the workflow's rules use these patterns."""

SCENE = "scenes/{dataset}/{scene}"
DEPTHS = "depths/{dataset}/{scene}"
TRAINING = "training/{network}"
FINETUNED = "geometry/vggt.safetensors"
POINT_MAPS = "point-maps/{dataset}/{scene}.npz"
PAIRS = "pairs/{dataset}/{scene}.npz"
ARTIFACT_MASKS = "artifact-masks/{dataset}/{scene}.npz"
MASK_LIBRARY = "artifact-masks/library.npz"
MASK_FIGURE = "figures/artifact-masks.png"
TARGETS = "targets/{dataset}/{scene}.json"
TRUTH = "truth/{dataset}/{scene}"
REFERENCES = "references/{dataset}/{scene}.npz"
MASKS = "masks/{dataset}/{scene}.npz"
TRAINED = "trained/{training}.seed{seed}"
MODEL = "models/{dataset}/{scene}/{label}"
RENDERS = "renders/{dataset}/{scene}/{label}"
SCORE_PART = "parts/{dataset}/{scene}/{label}.scores.parquet"
COST_PART = "parts/{dataset}/{scene}/{label}.costs.parquet"
SET_SCORE_PART = "parts/{dataset}/{label}.set-scores.parquet"
DEPTH_SCORE_PART = "parts/{dataset}/{scene}/depth-scores.parquet"
SCORES = "scores.parquet"
COSTS = "costs.parquet"
SET_SCORES = "set-scores.parquet"
DEPTH_SCORES = "depth-scores.parquet"
MANIFEST = "manifest.json"
TABLE = "tables/{table}"
FIGURE = "figures/{table}.png"
ABLATION_TABLE = "tables/ablation"
COST_TABLE = "tables/costs"
GEOMETRY_TABLE = "tables/geometry"
COMPLEXITY_TABLE = "tables/complexity"
PRETRAINED = "pretrain/{weights}.safetensors"
CHART = "charts/{table}"
REPORT = "report.html"

RESULT_FOLDERS = {"tables", "figures", "charts"}
DATA_FOLDERS = {
    pattern.split("/")[0]
    for name, pattern in list(vars().items())
    if name.isupper() and "/" in pattern
} - RESULT_FOLDERS | {"logs", "benchmarks"}
"""Folders of a run that hold what its results are made of; all others hold results."""
