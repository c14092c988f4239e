"""The page at ``/docs``: the OpenAPI document for people, with a button to try each path.

Made here rather than by the framework's viewers, because those load their scripts from the internet and many sites
have none.
"""

from __future__ import annotations

import json
from html import escape
from typing import Any

__all__ = ["docs_page"]

_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1b2430;background:#fff}
code,pre{font:14px/1.4 ui-monospace,monospace}pre{background:#f2f4f7;padding:.8rem;overflow:auto;max-height:24rem}
section{border-top:1px solid #cdd3dc;margin-top:1.5rem}h2 code{font-size:1.1rem}
td,th{text-align:left;padding:.1rem 1rem .1rem 0}
input,button{font:inherit;padding:.2rem .5rem}:focus{outline:2px solid #1f5fbf}
@media(prefers-color-scheme:dark){body{color:#e4e8ee;background:#14181e}pre{background:#1f252e}}
"""

_SCRIPT = """
async function attempt(button){
  const section=button.closest("section"),query=new URLSearchParams();let path=section.dataset.path;
  for(const field of section.querySelectorAll("input")){
    if(field.dataset.in==="path")path=path.replace("{"+field.name+"}",encodeURIComponent(field.value));
    else if(field.value)query.set(field.name,field.value)}
  const out=section.querySelector(".answer");out.hidden=false;out.textContent="…";
  const stop=new AbortController();let text="";
  try{
    const reply=await fetch(path+(query.size?"?"+query:""),
      {headers:{Authorization:"Bearer "+document.getElementById("key").value},signal:stop.signal});
    const reader=reply.body.pipeThrough(new TextDecoderStream()).getReader();
    while(text.length<4000){
      const{value,done}=await reader.read();if(done)break;
      text+=value;out.textContent=reply.status+"\\n"+text}
    stop.abort();
    try{text=JSON.stringify(JSON.parse(text),null,1)}catch{}
    out.textContent=reply.status+"\\n"+text;
  }catch(error){if(error.name!=="AbortError")out.textContent=String(error)}
}
document.addEventListener("click",event=>{if(event.target.matches("button"))attempt(event.target)});
"""


def docs_page(document: dict[str, Any]) -> str:
    """Return the page that shows an OpenAPI document of reads."""
    info = document["info"]
    sections = "".join(_section(path, operations["get"]) for path, operations in document["paths"].items())
    schemas = "".join(
        f"<details><summary><code>{escape(name)}</code></summary>"
        f"<pre>{escape(json.dumps(schema, indent=1))}</pre></details>"
        for name, schema in sorted(document["components"]["schemas"].items())
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(info["title"])} API</title>'
        f'<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,"><style>{_STYLE}</style>'
        f"<h1>{escape(info['title'])} API</h1>"
        f"<p>{escape(info.get('description', ''))}</p>"
        '<p>For machines: <a href="/openapi.json">openapi.json</a>. '
        '<label>Key to try with: <input id="key" type="password" autocomplete="off"></label></p>'
        f"{sections}<section><h2>Schemas</h2>{schemas}</section><script>{_SCRIPT}</script></html>"
    )


def _section(path: str, operation: dict[str, Any]) -> str:
    rows = "".join(
        f"<tr><td><label><code>{escape(parameter['name'])}</code> "
        f'<input name="{escape(parameter["name"])}" data-in="{escape(parameter["in"])}"></label></td>'
        f"<td>{escape(parameter.get('description', ''))}</td></tr>"
        for parameter in operation.get("parameters", [])
    )
    content = next(iter(operation["responses"]["200"]["content"].values()))
    example = content["example"]
    shown = example if isinstance(example, str) else json.dumps(example, indent=1, ensure_ascii=False)
    errors = "".join(
        f"<li>{escape(status)}: {escape(answer['description'])}</li>"
        for status, answer in operation["responses"].items()
        if status != "200"
    )
    return (
        f'<section data-path="{escape(path)}"><h2><code>GET {escape(path)}</code></h2>'
        f"<p>{escape(operation.get('description', ''))}</p>"
        f"<table>{rows}</table><p><button>Try</button></p><pre class=answer hidden></pre>"
        f"<details><summary>Example and errors</summary><pre>{escape(shown)}</pre><ul>{errors}</ul></details></section>"
    )
