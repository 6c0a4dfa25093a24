"""From depth images, whoever took them, to scored poses."""
