"""The billiards scene: tables, motion on cloth, contacts."""
