"""The design editor: paint a body or a world in the browser, see at once whether it is valid, save it, try it out.

``documents`` says what is drawn, ``trials`` simulates it, ``page`` is what the browser gets, ``server`` answers it.
"""
