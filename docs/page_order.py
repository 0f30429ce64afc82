"""The parts of the site and their pages. Not part of the library."""

PARTS = {
    "Tutorials": {"quickstart": "Quick start"},
    "How to": {
        "train": "Train a policy",
        "codesign": "Search for a body",
        "evaluation": "Evaluate and compare",
        "see": "See and export",
        "custom_tasks": "Tasks of your own",
        "own_search": "Searches of your own",
        "clusters": "GPUs and clusters",
        "libraries": "Other libraries",
    },
    "Reference": {
        "commands": "Commands",
        "environments": "Environments",
        "policies": "Policies",
        "search": "Searches",
        "protocols": "Protocols",
        "physics": "Physics",
        "paper": "Paper and release",
        "formats": "File formats",
        "evogym": "Drop-in for EvoGym",
    },
    "Background": {
        "concepts": "How it works",
        "performance": "Performance",
        "reliability": "Reliability",
        "results": "Results",
        "figures": "All figures",
    },
    "FAQ": {"faq": "FAQ"},
}
"""Parts of the site and their pages, with their names in the left column; a page's title is its question."""
