"""``/v1/zones`` and ``/v1/exhibits``: list, one, add, replace, remove; JSON, or GeoJSON on plan or Earth."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
from fastapi import APIRouter, Depends, Header, Request
from shapely import Polygon
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from services.api.admin.catalogue import Catalogue, Entry
from services.api.admin.conditions import check_none_match
from services.api.admin.geojson import CRS, GEOJSON, Crs, Drawing, collection, drawing, placed
from services.api.admin.shapes import Kind
from services.api.examples import EXAMPLES
from services.api.nameless import reads_rules
from services.api.openapi import GONE, UNCHANGED, created, documented, errors
from services.api.openapi import drawn as drawn_too
from services.api.replies import Reply
from services.api.request_body import described, invalid, read_body
from shared.site import Site
from shared.site.geographic import PlanOnEarth

__all__ = ["Answers", "catalogue_routes"]

LARGEST = 4 * 2**20
"""Bytes."""
_IF_MATCH = Header(description="the ETag that was read: refuse with 412 if it was changed meanwhile")
_IF_NONE_MATCH = Header(description="* asks to replace nothing: refused with 412, new ones are added by POST")

_HEADERS = {"Cache-Control": "no-store", "Vary": "Accept"}


@dataclass(frozen=True)
class Answers:
    """What is told of a catalogue: the Structs, one entry as one of them, and the ready body of all."""

    shape: type[Reply]
    list_shape: type[Reply]
    one: Callable[[Entry[Any]], Reply]
    every: Callable[[], bytes]


def catalogue_routes(
    site: Site,
    kind: Kind[Any],
    catalogue: Catalogue[Any],
    answers: Answers,
    changed: Callable[[], Awaitable[None]],
) -> APIRouter:
    """Return the routes of one catalogue.

    Args:
        site: its floors and anchor.
        kind: how definitions are read and drawn.
        catalogue: where they are kept.
        answers: what is told of them.
        changed: awaited after a change, before it is answered.
    """
    router = APIRouter(prefix=f"/v1/{kind.name}s", tags=[f"{kind.name}s"], default_response_class=Response)
    earth = PlanOnEarth.of(site)
    floors = {floor.id: Polygon(floor.outline) for floor in site.floors}
    body = described(kind.shape, EXAMPLES[kind.shape])
    one_feature = kind.draw(msgspec.convert(EXAMPLES[kind.shape], kind.shape), None)
    many_features = collection([one_feature])
    body["requestBody"]["content"][GEOJSON] = {"schema": {"type": "object"}, "example": one_feature}

    def unnamed(request: Request) -> Callable[[Any], Any]:
        return (lambda told: told) if reads_rules(request.state.holder) else kind.unnamed

    def every_one(request: Request) -> bytes:
        if reads_rules(request.state.holder):
            return answers.every()
        told = msgspec.json.decode(answers.every(), type=answers.list_shape)
        name = f"{kind.name}s"
        return msgspec.json.encode(msgspec.structs.replace(told, **{name: [*map(kind.unnamed, getattr(told, name))]}))

    def respond(entry: Entry[Any], request: Request, status: int = 200) -> Response:
        headers = {"ETag": entry.etag, **_HEADERS}
        if status == 201:
            headers["Location"] = f"/v1/{kind.name}s/{entry.definition.id}"
        content = msgspec.json.encode(unnamed(request)(answers.one(entry)))
        return Response(content, status, headers, media_type="application/json")

    def drawn(entries: list[Entry[Any]], request: Request, crs: Crs, *, one: bool = False) -> Response:
        on_earth, told = placed(crs, earth), unnamed(request)
        features = [kind.draw(told(entry.definition), on_earth) for entry in entries]
        content = msgspec.json.encode(features[0] if one else collection(features))
        headers = {"ETag": entries[0].etag} if one else {}
        return Response(content, headers=headers | _HEADERS, media_type=GEOJSON)

    async def read(request: Request, crs: Crs, path_id: str | None = None) -> list[Any]:
        geojson = GEOJSON in request.headers.get("content-type", "")
        if not geojson and crs != "plan":
            raise invalid("crs", crs, f"plan; wgs84 goes with Content-Type: {GEOJSON}")
        content = await read_body(request, LARGEST)
        on_earth = placed(crs, earth)
        return await run_in_threadpool(kind.read, content, floors, geojson=geojson, earth=on_earth, path_id=path_id)

    @router.get("", responses=drawn_too(documented(answers.list_shape, 422), many_features) | UNCHANGED)
    async def all_of_them(request: Request, asked: Annotated[Drawing, Depends(drawing)]) -> Response:
        """All of them; as GeoJSON a FeatureCollection."""
        if asked.geojson:
            return await run_in_threadpool(drawn, list(catalogue.entries.values()), request, asked.crs)
        return Response(await run_in_threadpool(every_one, request), headers=_HEADERS, media_type="application/json")

    @router.post("", status_code=201, responses=created(answers.shape, 409, 413, 422, 503), openapi_extra=body)
    async def add(request: Request, crs: Annotated[Crs, CRS] = "plan") -> Response:
        """Add one; a GeoJSON FeatureCollection adds all that are in it, or none."""
        entries = await run_in_threadpool(catalogue.add, await read(request, crs))
        await changed()
        return respond(entries[0], request, 201)

    @router.get("/{item}", responses=drawn_too(documented(answers.shape, 404, 422), one_feature))
    async def one_of_them(item: str, request: Request, asked: Annotated[Drawing, Depends(drawing)]) -> Response:
        """One of them."""
        entry = catalogue.find(item)
        return drawn([entry], request, asked.crs, one=True) if asked.geojson else respond(entry, request)

    @router.put("/{item}", responses=documented(answers.shape, 404, 409, 412, 413, 422, 503), openapi_extra=body)
    async def replace(
        item: str,
        request: Request,
        crs: Annotated[Crs, CRS] = "plan",
        if_match: Annotated[str | None, _IF_MATCH] = None,
        if_none_match: Annotated[str | None, _IF_NONE_MATCH] = None,
    ) -> Response:
        """Put another definition in the place of one."""
        check_none_match(if_none_match, catalogue.find(item).etag)
        (definition,) = await read(request, crs, item)
        before, entry = await run_in_threadpool(catalogue.replace, item, definition, if_match)
        request.state.audit = msgspec.json.encode(before.definition).decode()
        await changed()
        return respond(entry, request)

    @router.delete("/{item}", status_code=204, responses=GONE | errors(404, 409, 412, 503))
    async def remove(item: str, request: Request, if_match: Annotated[str | None, _IF_MATCH] = None) -> Response:
        """Take one out."""
        before = await run_in_threadpool(catalogue.remove, item, if_match)
        request.state.audit = msgspec.json.encode(before.definition).decode()
        await changed()
        return Response(status_code=204)

    return router
