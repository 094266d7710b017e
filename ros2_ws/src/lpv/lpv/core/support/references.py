"""Named tuples of arrays reach compiled functions by reference.

Numba hands a tuple on part by part: eight words for every array, and a monitor has two hundred of
them.  Handing them on took longer than the arithmetic.  Here a named tuple of this project is
unpacked once, where Python calls a compiled function; the others get its address.  Compiled
functions therefore make no such tuples.
"""

import hashlib
from typing import Any

from llvmlite import ir
from numba.core import boxing, cgutils, pythonapi, types
from numba.core.datamodel import models
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    register_model,
    typeof_impl,
    unbox,
)


class Reference(types.Type):
    """Type of the address of a named tuple; ``record`` is that of the tuple."""

    def __init__(self, record: Any) -> None:
        self.record = record
        digest = hashlib.sha256(record.name.encode()).hexdigest()[:12]
        super().__init__(f'{record.instance_class.__name__}_{digest}')


_by_value = typeof_impl.dispatch(tuple)


@typeof_impl.register(tuple)
def _typeof(value: Any, context: Any) -> Any:
    found = _by_value(value, context)
    named = isinstance(found, (types.NamedTuple, types.NamedUniTuple))
    return Reference(found) if named and type(value).__module__.startswith('lpv') else found


@register_model(Reference)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Reference) -> None:
        pointer = manager.lookup(kind.record).get_value_type().as_pointer()
        super().__init__(manager, kind, pointer)


@unbox(Reference)
def _unbox(kind: Reference, value: Any, c: Any) -> NativeValue:
    """Unpack a tuple into memory of the caller, which nothing writes to later."""
    native = c.unbox(kind.record, value)
    place = cgutils.alloca_once(c.builder, c.context.get_value_type(kind.record))
    c.builder.store(native.value, place)
    # What is read there must not be taken for what was there before.
    unknown = ir.FunctionType(place.type, [place.type])
    place = c.builder.asm(unknown, '', '=r,0,~{memory}', [place], True)

    def cleanup() -> None:
        if native.cleanup is not None:
            native.cleanup()
        if c.context.enable_nrt:  # of an address, Numba would let nothing go
            c.context.nrt.decref(c.builder, kind.record, native.value)

    return NativeValue(place, is_error=native.is_error, cleanup=cleanup)


def _unbox_generator(kind: Any, value: Any, c: Any) -> NativeValue:
    """Unpack a random generator; what counts its references is let go where nothing else is."""
    native = boxing.unbox_numpy_random_generator(kind, value, c)
    if c.context.enable_nrt:
        return native

    def cleanup() -> None:
        place = c.context.data_model_manager[kind].get_field_position('meminfo')
        info = c.builder.extract_value(native.value, place)
        done = ir.FunctionType(ir.VoidType(), [info.type])
        let_go = cgutils.get_or_insert_function(c.builder.module, done, 'NRT_MemInfo_call_dtor')
        c.builder.call(let_go, [info])

    return NativeValue(native.value, is_error=native.is_error, cleanup=cleanup)


pythonapi._unboxers.functions[types.NumPyRandomGeneratorType] = _unbox_generator


@infer_getattr
class _Fields(AttributeTemplate):
    key = Reference

    def generic_resolve(self, kind: Reference, name: str) -> Any:  # type: ignore[override]
        fields = kind.record.fields
        return kind.record[fields.index(name)] if name in fields else None


@lower_getattr_generic(Reference)
def _field(context: Any, builder: Any, kind: Reference, value: Any, name: str) -> Any:
    index = kind.record.fields.index(name)
    field = kind.record[index]
    place = cgutils.gep_inbounds(builder, value, 0, index)
    loaded = _load(builder, place, context.get_value_type(field))
    return impl_ret_borrowed(context, builder, field, loaded)


def _load(builder: Any, place: Any, kind: Any) -> Any:
    """Load a value part by part, each of which never changes: loops need not load it again."""
    if isinstance(kind, (ir.LiteralStructType, ir.ArrayType)):
        value = ir.Constant(kind, ir.Undefined)
        for k in range(len(kind)):
            part = _load(builder, cgutils.gep_inbounds(builder, place, 0, k), kind.elements[k])
            value = builder.insert_value(value, part, k)
        return value
    loaded = builder.load(place)
    loaded.set_metadata('invariant.load', builder.module.add_metadata([]))
    return loaded
