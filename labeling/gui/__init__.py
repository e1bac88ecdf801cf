"""The labeling window: choose what a demonstration attends to, by one click per target.

From the outside in: `app` (server, tabs, events), `views` and `panels` (what the browser shows)
know viser; nothing else does. `session` is one tab's work and `desk` what tabs share. `draft`
holds a selection with undo, `journal` keeps drafts on disk, `picking` and `planes` say what a
click means, `episode_scene` reads an episode, `pictures` draws attention, `checks` warns,
`prelabels` proposes, `keys` and `texts` are words.
"""
