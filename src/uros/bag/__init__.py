"""Bags: recordings of topics in the formats of rosbag2, MCAP and SQLite. Host only.

====================  ============================================================================
``metadata``          The metadata of a bag, and ``metadata.yaml`` of its folder.
``writer``            Writes a bag: a folder of files with ``metadata.yaml``.
``reader``            Reads a bag: a folder with ``metadata.yaml``, or a single file.
``recover``           Finishes a bag whose recording was cut off.
``reindex``           Writes ``metadata.yaml`` of a bag from its files.
``convert``           Writes bags with other settings: merges, splits, compresses them.
``definitions``       The definitions of a type and all its nested types as one text.
``storage``           The storages by their names, and the contracts of their files.
``compression``       Compression by zstd and lz4.
``packed``            Files and messages that rosbag2 has compressed itself.
``mcap_codec``        The records of MCAP, to and from bytes.
``mcap_records``      Records of MCAP files, found within limits.
``mcap_index``        What an MCAP file has: schemas, channels, counts, blocks with messages.
``mcap_reader``       Reads an MCAP file, in the order of time and with bounded memory.
``mcap_writer``       Writes an MCAP file.
``mcap_salvage``      Finds what can still be read of a damaged MCAP file.
``sqlite_reader``     Reads an SQLite file.
``sqlite_writer``     Writes an SQLite file.
``sqlite_salvage``    Finds what can still be read of a damaged SQLite file.
``qos_profiles``      QoS profiles in metadata, with numbers or names for policies.
``yaml_text``         YAML of bags, read and written by PyYAML within limits.
``lock``              The lock of a bag that is recorded or recovered.
``errors``            The error of bags.
====================  ============================================================================
"""
