"""What tests of USD scenes share."""


def pairs(scene):
    """Return the pairs that collide; no contact lists one of another."""
    names = [
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    ]
    assert len(names) == len(set(names))
    return set(names)
