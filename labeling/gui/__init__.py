"""The labeling window: choose what a demonstration attends to, by one click per target.

From the outside in: `app` is the server, `tab` one browser tab and its events, `stage` its view,
`reel` its pictures in time. `views` and `panels` are what the browser shows; with `app` they alone
know viser. `session` is one tab's work and `desk` what tabs share. `draft` holds a selection with
undo, `journal` keeps drafts on disk, `picking` and `planes` say what a click means,
`episode_scene` reads an episode, `pictures` draws attention, `checks` warns, `prelabels` proposes,
`keys` and `texts` are words, `access` says who may come in. `scripted` is an operator for tests,
`bench`, `kill_drill` and `screenshots` are commands.
"""
