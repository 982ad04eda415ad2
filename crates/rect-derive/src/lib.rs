//! The derive macro of RECT for parameters; use it through the crate `rect-robot`.
use proc_macro::TokenStream;
use proc_macro2::TokenStream as Tokens;
use quote::quote;
use syn::{
    ext::IdentExt, parse_macro_input, punctuated::Punctuated, spanned::Spanned, Attribute, Data,
    DeriveInput, Error, Expr, Field, Fields, Lit, LitStr, Meta, Result, Token,
};

/// Makes the fields of a struct the parameters of a group, for `Robot::parameters`.
///
/// A field is a `bool`, an integer of up to 32 bits or `i64`, `f64`, `f32`, `String` or `Vec<f64>`. Its documentation comment is its
/// description, and `#[parameter(...)]` states the rest:
///
/// | part | meaning | default |
/// |---|---|---|
/// | `default = 1.0` | the value until somebody changes it | `Default::default()`; the first choice |
/// | `min = 0.0`, `max = 10.0` | the range of a number, or of each number of a list | that of the type |
/// | `unit = "m/s"` | the unit | none |
/// | `choices("left", "right")` | the texts that a `String` may have | any text |
/// | `read_only` | only the program itself changes it | anybody who may |
///
/// ```ignore
/// #[derive(rect::Parameters)]
/// struct Drive {
///     /// Gain of the heading
///     #[parameter(default = 1.0, min = 0.0, max = 10.0, unit = "1/s")]
///     kp: f64,
///     #[parameter(choices("left", "right"))]
///     side: String,
///     turbo: bool,
/// }
/// ```
#[proc_macro_derive(Parameters, attributes(parameter))]
pub fn derive_parameters(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    implementation(&input)
        .unwrap_or_else(Error::into_compile_error)
        .into()
}

fn implementation(input: &DeriveInput) -> Result<Tokens> {
    let fields = match &input.data {
        Data::Struct(data) => match &data.fields {
            Fields::Named(fields) => &fields.named,
            _ => {
                return Err(Error::new(
                    input.span(),
                    "parameters need fields with names",
                ))
            }
        },
        _ => return Err(Error::new(input.span(), "only a struct can be parameters")),
    };
    let declarations = fields.iter().map(declaration).collect::<Result<Vec<_>>>()?;
    let reads = fields.iter().map(|field| {
        let (name, ty) = (&field.ident, &field.ty);
        quote! {
            #name: values
                .next()
                .map(<#ty as ::rect::ParameterField>::from_value)
                .unwrap_or_default()
        }
    });
    let name = &input.ident;
    let (generics, types, bounds) = input.generics.split_for_impl();
    Ok(quote! {
        impl #generics ::rect::Parameters for #name #types #bounds {
            fn parameters() -> ::std::vec::Vec<::rect::Parameter> {
                ::std::vec![#(#declarations),*]
            }

            fn from_values<'a>(
                mut values: impl ::std::iter::Iterator<Item = &'a ::rect::ParameterValue>,
            ) -> Self {
                Self { #(#reads),* }
            }
        }
    })
}

/// The contents of the attribute of a field.
#[derive(Default)]
struct Stated {
    default: Option<Expr>,
    min: Option<Expr>,
    max: Option<Expr>,
    unit: Option<LitStr>,
    choices: Vec<LitStr>,
    read_only: bool,
}

/// Returns the expression of the declaration of a field.
fn declaration(field: &Field) -> Result<Tokens> {
    let ident = field.ident.as_ref().map(IdentExt::unraw);
    let name = ident.map(|ident| ident.to_string()).unwrap_or_default();
    let ty = &field.ty;
    let stated = stated(&field.attrs)?;
    let default = match (&stated.default, stated.choices.first()) {
        (Some(Expr::Lit(literal)), _) if matches!(literal.lit, Lit::Str(_)) => {
            quote!(::std::convert::From::from(#literal))
        }
        (Some(default), _) => quote!(#default),
        (None, Some(first)) => quote!(::std::convert::From::from(#first)),
        (None, None) => quote!(::std::default::Default::default()),
    };
    let mut declaration = quote!(<#ty as ::rect::ParameterField>::parameter(#name, #default));
    if stated.min.is_some() || stated.max.is_some() {
        let min = limit(stated.min.as_ref(), &quote!(min));
        let max = limit(stated.max.as_ref(), &quote!(max));
        declaration = quote!({
            let parameter = #declaration;
            let (min, max) = (#min, #max);
            parameter.range(min, max)
        });
    }
    if let Some(unit) = &stated.unit {
        declaration = quote!(#declaration.unit(#unit));
    }
    if !stated.choices.is_empty() {
        let choices = &stated.choices;
        declaration = quote!(#declaration.choices([#(#choices),*]));
    }
    if stated.read_only {
        declaration = quote!(#declaration.read_only());
    }
    let about = about(&field.attrs);
    if !about.is_empty() {
        declaration = quote!(#declaration.about(#about));
    }
    Ok(declaration)
}

/// Returns a limit of a range; that of the type if none is stated.
fn limit(stated: Option<&Expr>, of_type: &Tokens) -> Tokens {
    match stated {
        Some(limit) => quote!(::std::option::Option::Some((#limit) as f64)),
        None => quote!(parameter.#of_type),
    }
}

fn stated(attributes: &[Attribute]) -> Result<Stated> {
    let mut stated = Stated::default();
    for attribute in attributes {
        if !attribute.path().is_ident("parameter") {
            continue;
        }
        attribute.parse_nested_meta(|meta| {
            let part = meta.path.get_ident().map(ToString::to_string);
            match part.as_deref() {
                Some("default") => stated.default = Some(meta.value()?.parse()?),
                Some("min") => stated.min = Some(meta.value()?.parse()?),
                Some("max") => stated.max = Some(meta.value()?.parse()?),
                Some("unit") => stated.unit = Some(meta.value()?.parse()?),
                Some("choices") => {
                    let list;
                    syn::parenthesized!(list in meta.input);
                    let choices = Punctuated::<LitStr, Token![,]>::parse_terminated(&list)?;
                    stated.choices = choices.into_iter().collect();
                }
                Some("read_only") => stated.read_only = true,
                _ => {
                    let expected = "expected default, min, max, unit, choices or read_only";
                    return Err(meta.error(expected));
                }
            }
            Ok(())
        })?;
    }
    Ok(stated)
}

/// Returns the first line of the documentation comment.
fn about(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| {
        let Meta::NameValue(pair) = &attribute.meta else {
            return None;
        };
        match &pair.value {
            Expr::Lit(literal) if pair.path.is_ident("doc") => match &literal.lit {
                Lit::Str(text) => Some(text.value().trim().to_owned()),
                _ => None,
            },
            _ => None,
        }
    });
    lines
        .take_while(|line| !line.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}
