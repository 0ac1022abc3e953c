"""The help of the commands: what each does, examples, and texts that several options share."""

OVERVIEW = "Simulate and measure epithelial tissues as Voronoi cells of backbones."
FIRST_STEPS = """\
first steps:
  with a segmented image:
    jaxtissue fit labels.tif --out fitted
  with a table of backbones:
    jaxtissue measure cells.csv --length 40 --apical-radius 2 --basal-radius 8 \\
      --out measured
  without data:
    jaxtissue anneal --cells 100 --length 20 --out my-run

jaxtissue COMMAND --help lists the options of a command and their defaults."""

SUMMARIES = {
    "anneal": "anneal one tissue by Metropolis-Hastings sweeps, or resume a run",
    "relax": "relax one tissue to a minimum of its energy",
    "grid": "anneal a tissue for every combination of parameters",
    "measure": "measure the cells and contacts of given backbones",
    "fit": "fit a tissue to a segmented image",
    "compare": "compare the accuracy of the presets on given backbones",
    "reproduce": "reproduce the table and the figures of the paper",
    "export": "export the tissue of a run to other file formats",
    "view": "draw the tissue of a run in 3D",
    "info": "show versions, devices, precision and optional packages",
}
DESCRIPTIONS = {
    "anneal": """\
Anneal one tissue and write tables, figures and an HTML page to a folder.
The defaults are those of the paper. --resume continues a stopped run.""",
    "relax": """\
Follow the gradient of the energy to a minimum, and write the relaxed tissue
with tables and figures to a folder.""",
    "grid": """\
Anneal one tissue for every combination of the given parameters, and collect
the results in DIR/table.csv. Repeat the command to compute missing rows.""",
    "measure": """\
Measure the cells of given backbones: volumes, areas, neighbors, scutoids.
Needs the three sizes of the tube, or --domain.""",
    "fit": """\
Fit a tube, flat sheet or closed shell and its backbones to a segmented image.
The commands measure and anneal continue from the files that this command
writes. With --nodes the backbones are tilted or bent.""",
    "compare": """\
Compare the cell sizes of each preset with those of a slow independent method.
Needs the three sizes of the tube, or --domain.""",
    "reproduce": """\
Reproduce Table 1 and Figures 5 and 7 to 16 of the paper, and write a report
that compares each number of the paper with the number found here.

The paper: J. Buceta, S. Funke, S. Storandt, "Efficient Modeling of 3D
Epithelial Cell Structure Dynamics via Backbone Spreads", GRAPP 2025.""",
    "export": "Write the tissue of a run in the file formats of other programs.",
    "view": "Draw the tissue of a run or one of its cells in 3D, or make a movie.",
    "info": "Show versions, devices, precision and the optional packages installed.",
}
EXAMPLES = {
    "anneal": """\
examples:
  jaxtissue anneal --cells 100 --length 20 --out my-run
  jaxtissue anneal --out my-run --resume --sweeps 200""",
    "relax": """\
example:
  jaxtissue relax --backbones my-run/backbones.csv --length 20 --out minimum""",
    "grid": """\
example (nine tissues):
  jaxtissue grid --ratio 2 5 10 --seed 0 1 2 --out grid""",
    "measure": """\
example:
  jaxtissue measure cells.csv --length 40 --apical-radius 2 --basal-radius 8 \\
    --out measured""",
    "fit": """\
example (slices 1 um apart, pixels of 0.5 um):
  jaxtissue fit labels.tif --spacing 1 0.5 0.5 --out fitted""",
    "compare": """\
example:
  jaxtissue compare cells.csv --length 40 --apical-radius 2 --basal-radius 8""",
    "reproduce": """\
example:
  jaxtissue reproduce --quick --out paper""",
    "export": """\
example:
  jaxtissue export my-run --to ome-tiff vtu csv --out exported""",
    "view": """\
example:
  jaxtissue view my-run --what scutoid""",
    "info": "",
}

BACKBONES = "CSV table with one backbone per row: columns axial and angle, or those of the domain"
DEGREES = "angles in the table are in degrees (default: radians)"
RESOLUTION = "draft, standard, fine, or LAYERSxLINES such as 8x12"
ALGORITHM = "is-mh: rounds of independent moves; mh: one move at a time"
METHODS = (
    "lbfgs: L-BFGS; fire: gradient descent with inertia; lloyd: move backbones to the centroids of their cells, "
    "whatever the energy"
)
DESCENT_TOLERANCE = "stop when the norm of the gradient, or with lloyd of the moves, is F times its initial value"
MODULUS = "weight K of the volume term of the energy"
TENSION = "weight Lambda of the lateral area in the energy"
COOLING = "cool to this temperature, by a constant factor per sweep"
MINIMUM = "ignore contacts with a wall area below F times the mean wall area"
NO_CONTACTS = "measure sizes only; do not find contacts and transition points"
RELATIVE = (
    "use dimensionless K, LAMBDA and T: volumes in units of the mean cell volume Vbar, areas in units of Vbar^(2/3); "
    "the paper's tube of 500 cells then has --tension 0.0016 --temperature 0.0005"
)
NODES = (
    "points that each backbone goes through from surface to surface; 2: tilted, 3 or more: bent backbones "
    "(default: 1, straight)"
)
RUN = "folder written by anneal, relax, measure or fit"
