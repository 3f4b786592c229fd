"""The verb `sitl world`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.command_line import AsJson, Result, conclude
from companion.exit_codes import ExitCode

if TYPE_CHECKING:
    import numpy as np

    from sitl.worlds.sites import Site

_Seed = typer.Option(
    min=0, max=2**63 - 1, help="Everything random comes from it; from 1000000000 on held out."
)


def world(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME|FILE", help="Site of the catalogue, YAML list of bodies, or mesh."),
    ],
    seed: Annotated[int, _Seed] = 1,
    followers: Annotated[
        int, typer.Option(min=0, max=20, help="The free disc at the start is for these.")
    ] = 4,
    voxel: Annotated[float, typer.Option(min=0.02, max=5.0, help="Resolution of a mesh, m.")] = 0.2,
    out: Annotated[Path | None, typer.Option(metavar="PAGE", help="Draw it from above (HTML).")] = None,
    json_output: AsJson = False,
) -> None:
    """Build one scene of a world, say what is in it and draw it.

    Names: none, pillars_10m, pillars_5m, simplified_forest, forest, indoor_blocks, indoor_wall,
    outdoor_pillars, display_tower, short_forest. A file ends in .yaml or .yml, or is a mesh (.ply, .stl,
    .obj, .off, .gltf, .glb) in metres with z up.
    """

    def body() -> tuple[Result, ExitCode]:
        import numpy as np

        from companion.kernel_cache import forget_stale

        forget_stale(("sitl",))
        site = _site(name, np.random.default_rng(seed), followers, voxel)
        result = _described(site, seed)
        if out is not None:
            _draw(site, result, out)
            result["page"] = str(out)
        if not json_output:
            _show(result)
        return result, ExitCode.OK

    conclude(body, json_output)


def _site(name: str, rng: "np.random.Generator", followers: int, voxel_m: float) -> "Site":
    from companion.errors import ProfileError
    from sitl.worlds import mesh
    from sitl.worlds.settings import WorldSettings, site_of
    from sitl.worlds.sites import SITE_NAMES, build_site

    if name in SITE_NAMES:
        return build_site(name, rng, followers=followers)
    suffix = Path(name).suffix.lower()
    if suffix in (".yaml", ".yml"):
        settings = WorldSettings(file=name)
    elif suffix in mesh.FORMATS:
        settings = WorldSettings(mesh=name, mesh_voxel_m=voxel_m)
    else:
        raise ProfileError(
            f"{name}: found neither a site nor a file of a known kind; sites are {', '.join(SITE_NAMES)}; "
            f"files end in .yaml, .yml, {', '.join(mesh.FORMATS)}"
        )
    return site_of(settings, rng, folder=Path(), followers=followers)


def _described(site: "Site", seed: int) -> dict[str, Any]:
    import numpy as np

    from sitl.worlds.plan_view import CUT_HEIGHT_M, NAMES
    from sitl.worlds.seeds import is_held_out

    obstacles = site.world.obstacles()
    way = np.vstack([site.spawn_world, site.waypoints_world])
    points = np.column_stack([way, np.full(len(way), CUT_HEIGHT_M)])
    rooms = obstacles.clearance(points)
    counts = {label: int(np.count_nonzero(site.world.kinds == kind)) for kind, label in NAMES.items()}
    return {
        "world": site.name,
        "seed": seed,
        "held_out": is_held_out(seed),
        "primitives": {label: count for label, count in counts.items() if count},
        "spawn_world_m": np.round(site.spawn_world, 3).tolist(),
        "waypoints_world_m": np.round(site.waypoints_world, 3).tolist(),
        "length_m": round(float(np.hypot(*np.diff(way, axis=0).T).sum()), 3),
        "free_m": [round(float(room), 3) if np.isfinite(room) else None for room in rooms],
    }


def _draw(site: "Site", facts: Result, out: Path) -> None:
    from companion.logs.figure_page import write_whole
    from sitl.worlds.plan_view import page

    title = f"{site.name}, seed {facts['seed']}"
    write_whole(out, page(site, title, _bodies(facts)))


def _bodies(facts: Result) -> str:
    return ", ".join(f"{count} {label}" for label, count in facts["primitives"].items())


def _show(facts: Result) -> None:
    def place(xy: list[float]) -> str:
        return f"({xy[0]:.1f}, {xy[1]:.1f})"

    def room(metres: float | None) -> str:
        return "nothing near" if metres is None else f"{metres:.1f} m free"

    rows = [
        ("world", facts["world"]),
        ("seed", f"{facts['seed']}, {'held out for tests' if facts['held_out'] else 'for training'}"),
        ("bodies", _bodies(facts) or "none"),
        ("start", f"{place(facts['spawn_world_m'])}, {room(facts['free_m'][0])}"),
    ]
    for waypoint, free in zip(facts["waypoints_world_m"], facts["free_m"][1:], strict=True):
        rows.append(("waypoint", f"{place(waypoint)}, {room(free)}"))
    rows.append(("way", f"{facts['length_m']:.1f} m"))
    if "page" in facts:
        rows.append(("page", facts["page"]))
    for label, value in rows:
        typer.echo(f"{label:<10} {value}")
