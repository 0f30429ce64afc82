"""The design editor: paint a body or a world in the browser, validate, save and simulate it.

``documents`` says what is drawn, ``trials`` simulates it, ``page`` is what the browser gets, ``server`` answers it.
"""
