"""The page in Jinja's language. It loads nothing: the policy in its head forbids it, and every picture is inline."""

TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{{ title }}</title>
<style>
:root { color-scheme: light; --ink: #262c34; --faint: #5c646e; --line: #dfe3e6; --blue: #1f6f8b; --warm: #fbf6ee; }
body { margin: 0 auto; max-width: 72rem; padding: 2rem 1.2rem 4rem; color: var(--ink); background: #fff;
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.7rem; margin: 0; }
h2 { font-size: 1.2rem; margin: 2.6rem 0 .6rem; border-bottom: 1px solid var(--line); padding-bottom: .2rem; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p.lead, figcaption, .note { color: var(--faint); }
.note { font-size: .86rem; margin: .3rem 0; }
nav a { margin-right: 1rem; color: var(--blue); text-decoration: none; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums; }
th, td { padding: .22rem .7rem .22rem 0; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
th { font-weight: 600; }
.tight td, .tight th { white-space: nowrap; }
tr.aside td { color: var(--faint); font-style: italic; }
figure { margin: 1rem 0; }
img { max-width: 100%; height: auto; }
pre { background: #f4f6f7; padding: .7rem .9rem; overflow-x: auto; font-size: .82rem; white-space: pre-wrap; }
code { font-size: .9em; overflow-wrap: anywhere; }
.missing { background: var(--warm); border-left: 3px solid #d99a2b; padding: .5rem .9rem; margin: .6rem 0; }
summary { cursor: pointer; color: var(--blue); }
</style>
</head>
<body>
<header>
<h1>{{ title }}</h1>
<p class="lead">{{ lead }}</p>
<nav>{% for section in sections %}<a href="#{{ section.key }}">{{ section.title }}</a>{% endfor %}</nav>
</header>
{% for section in sections %}
<section id="{{ section.key }}">
<h2>{{ section.title }}</h2>
{% for block in section.blocks %}
{% if block.kind == "table" %}
{% if block.title %}<h3>{{ block.title }}</h3>{% endif %}
{% if block.fold %}<details><summary>{{ block.fold }}</summary>{% endif %}
<div class="scroll"><table{% if block.tight %} class="tight"{% endif %}>
<thead><tr>{% for cell in block.head %}<th>{{ cell }}</th>{% endfor %}</tr></thead>
<tbody>
{% for row in block.rows %}<tr{% if row.aside %} class="aside"{% endif %}>
{%- for cell in row.cells %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</tbody>
</table></div>
{% if block.fold %}</details>{% endif %}
{% for note in block.notes %}<p class="note">{{ note }}</p>{% endfor %}
{% elif block.kind == "picture" %}
<figure><img src="{{ block.uri }}" alt="{{ block.caption }}"><figcaption>{{ block.caption }}</figcaption></figure>
{% elif block.kind == "missing" %}
<div class="missing">{{ block.what }}{% if block.command %}: <code>{{ block.command }}</code>{% endif %}</div>
{% elif block.kind == "text" %}
<p>{{ block.text }}</p>
{% elif block.kind == "code" %}
<details><summary>{{ block.title }}</summary><pre>{{ block.text }}</pre></details>
{% endif %}
{% endfor %}
</section>
{% endfor %}
</body>
</html>
"""
