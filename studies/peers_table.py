"""Check of the guide's table of peers: a small call of an installed package for each cell."""

from peers_table.cells import FOUND, checks_of, run
from peers_table.rows import PEERS, ROWS
from polyida.cli.study import main
from polyida.study.plotting import panels, picture, study_figure
from polyida.study.rows import distinct, pick
from polyida.study.tasks import Study

ALWAYS = ("polyida", "scikit-sundae")  # what an installed polyida has beside it


def tasks(quick):
    """Each cell with a check; the quick selection has those of packages that are always installed."""
    return [{"peer": peer, "row": row} for peer in (ALWAYS if quick else PEERS) for row in ROWS if row in checks_of(peer)]


def figures(rows):
    """Number of confirmed cells of each peer."""
    good = [row for row in rows if not row.get("error")]
    return {f"{peer}_seen": float(len(pick(good, peer=peer, found="seen"))) for peer in distinct(good, "peer")}


def notes(rows):
    """Packages that are not installed, with the command that installs them."""
    missing = {row["peer"] for row in rows if row.get("found") == "not installed"}
    return [f"{peer} is not installed: {PEERS[peer].install}" for peer in PEERS if peer in missing]


@study_figure
def draw(rows):
    """Confirmed completely or partly (squares), absent (crosses), package not installed (dots); cells without a mark have a source in the
    guide instead of a call.
    """
    from polyida.show.styles import PALETTE

    peers, names = distinct(rows, "peer"), [name for name in ROWS if pick(rows, row=name)]
    fig, (axes,) = panels(1 if rows else 0, columns=1, height=0.8 + 0.2 * len(names))
    for k, (result, marker) in enumerate(zip(FOUND, "sx.")):
        places = [(peers.index(row["peer"]), names.index(row["row"])) for row in pick(rows, found=result)]
        if places:
            axes.plot(*zip(*places), marker, color=PALETTE[k], label=result)
    axes.set_xticks(range(len(peers)), peers, rotation=30, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return picture(fig, "peers_table")


study = Study(
    "peers_table",
    "Check of the table of peers",
    tasks,
    run,
    figures,
    draw,
    notes=notes,
    headline=("polyida_seen", "scikit-sundae_seen"),
    columns=("peer", "version", "row", "found", "says"),
    isolated=True,
    fresh=False,
    limit=120.0,
)

if __name__ == "__main__":
    main(study)
